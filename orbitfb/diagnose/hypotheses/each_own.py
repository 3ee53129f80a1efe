"""Some devices with the same law and values of each one's own."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.onsets.every import every, shown_together
from orbitfb.diagnose.hypotheses.ranking import Ranked, any_size, cost_of, needles, scales, within
from orbitfb.diagnose.hypotheses.refit import Course, moved, spectrum_of, step_of
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.hypotheses.sets import grown_apart
from orbitfb.diagnose.likelihood.corrected import over
from orbitfb.diagnose.likelihood.seen import semidefinite
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.laws import DeviceLaw
from orbitfb.estimation.evidence import NormalTerms, given_size
from orbitfb.estimation.priors import (
    HOPE,
    MOST_REFINED,
    NEARER,
    NEARER_TURNS,
    OWN_REACH,
    OWN_TURNS,
    OWN_VALUES,
    SCATTERED,
    SIZE_WIDTH,
    STEPS,
    VALUE_COST,
)
from orbitfb.estimation.transform import Matrix

_REACH = float(np.log(4.0))
"""Logarithm of the ratio within which a value is sought that hardly differs within a grid. By hand:
a grid has one or two of them."""


def scan_each_own(
    kind: EffectKind, law: DeviceLaw, scorer: Scorer, rank: Ranked
) -> list[Candidate]:
    """Find devices with values of each one's own: a set that is grown, and all of them.

    A set grows of devices each at the value of the grid that suits it best. All of them have one
    value and a size of each one's own, if the law has a size. What healthy devices have, too, is
    told by their errors (`healthy`), but to first order: it is found here if it can be undone.

    Args:
        kind: The effect.
        law: One of its laws.
        scorer: Of what is left to explain.
        rank: Of the values of its grid.

    Returns:
        The best set of two devices or more, and all of them, as far as they have evidence.
    """
    if not kind.collective or rank.alone.max() < HOPE:
        return []
    if not scorer.is_usual(kind):
        return [*_some(kind, law, scorer, rank), *_every(kind, law, scorer, rank)]
    if law.undone is None or kind.linear is None:
        return []
    return [*_some(kind, law, scorer, rank), *_undone(kind, law, scorer, rank)]


def _undone(kind: EffectKind, law: DeviceLaw, scorer: Scorer, rank: Ranked) -> list[Candidate]:
    """All devices with errors that are undone in what they read.

    That takes off what large ones make of the noise and of an orbit that wanders, too.
    """
    best = np.maximum(rank.alone.max(axis=0), 0.0)
    gain = float(shown_together(best[None])[0])
    if gain <= 0.0:
        return []
    return _of_all(kind, law, scorer, rank.grid[0], gain)


def _some(kind: EffectKind, law: DeviceLaw, scorer: Scorer, rank: Ranked) -> list[Candidate]:
    """The best set of two devices or more."""
    free = scales(kind)
    if len(rank.alone) == 1 and not free:
        return []
    number = np.argmax(rank.alone, axis=0)
    chosen, evidence = _grown(kind, law, scorer, rank, number, free)
    if len(chosen) < (1 if rank.own else 2):
        return []
    places = tuple(sorted(chosen))
    return [
        Candidate(
            kind, places, tuple(law.names[place] for place in places),
            rank.values(int(number[chosen[0]]), chosen[0]), evidence,
            finer=lambda: _candidate(kind, law, scorer, rank, number, list(places), free),
        )
    ]  # fmt: skip


def _every(kind: EffectKind, law: DeviceLaw, scorer: Scorer, rank: Ranked) -> list[Candidate]:
    """All devices with sizes around zero of any scatter, at the value that tells most of them.

    No single one need show: a course that all have in common may hide in the floor, which any
    pattern over the devices may be in.
    """
    devices = len(law.names)
    if kind.linear is None or devices < 2:
        return []
    found = []
    for values in rank.promising or rank.grid[-1:]:
        spectra = scorer.space.courses.spectra(law, values)
        pull, information = scorer.score(law.patterns, spectra)
        information = semidefinite(scorer.marginal(kind, law.patterns, spectra, information))
        terms = [NormalTerms(pull, information, np.full(devices, width**2)) for width in SCATTERED]
        found += [(one.evidence(), values) for one in terms]
    gain, values = max(found, key=lambda one: one[0])
    return _of_all(kind, law, scorer, values, gain)


def _of_all(
    kind: EffectKind, law: DeviceLaw, scorer: Scorer, values: Values, gain: float
) -> list[Candidate]:
    """All devices at some values, told exactly later, if that is worth what the values cost."""
    cost = cost_of(kind, values, scorer)
    told = partial(every, kind, law, scorer, values, 0, cost)
    return [Candidate(kind, (), (), values, gain - cost, finer=told)] if gain > cost else []


def _grown(
    kind: EffectKind,
    law: DeviceLaw,
    scorer: Scorer,
    rank: Ranked,
    number: np.ndarray,
    free: bool,
) -> tuple[list[int], float]:
    """Devices that explain more than they cost, the strongest first, and their evidence."""
    spectra = [
        np.zeros((len(scorer.space.transform), len(number)), dtype=np.float32) for _ in law.patterns
    ]
    for value in np.unique(number):
        mine = np.flatnonzero(number == value)
        values = (*rank.grid, *rank.own)[value]
        for total, part in zip(spectra, scorer.space.courses.spectra(law, values), strict=True):
            total[:, mine] = part if part.shape[1] == 1 else part[:, mine]
    pull, information = scorer.score(law.patterns, spectra)
    information = scorer.marginal(kind, law.patterns, spectra, information)
    costs = np.array([_cost(kind, scorer, rank, number, at) for at in range(len(number))])
    return grown_apart(pull, information, costs, free)


def _cost(kind: EffectKind, scorer: Scorer, rank: Ranked, number: np.ndarray, device: int) -> float:
    """What choosing a device and its value costs [nats]."""
    cost = float(np.log(len(number)))
    if len(rank.alone) > 1:
        cost += VALUE_COST + needles(kind, rank.values(int(number[device]), device), scorer)
    return cost


def _candidate(
    kind: EffectKind,
    law: DeviceLaw,
    scorer: Scorer,
    rank: Ranked,
    number: np.ndarray,
    chosen: list[int],
    free: bool,
) -> Candidate:
    """Evaluate the set exactly."""
    sources = [
        Course(law, (place,), rank.values(int(number[place]), place), np.ones(1))
        for place in chosen
    ]
    logs = [p.name for p in kind.fitted(scorer.space.signals.record) if p.log and not p.whole]
    its = _Set(
        kind, free, sum(_cost(kind, scorer, rank, number, one) for one in chosen),
        tuple(logs) if len(rank.alone) > 1 else (),
        tuple(own[logs[0]] for own in rank.own if logs[0] in own) if logs else (),
    )  # fmt: skip
    return its.told(sources, scorer, MOST_REFINED)


@dataclass(frozen=True, slots=True, eq=False)
class _Set:
    """Some devices with values of each one's own.

    Args:
        kind: The effect.
        free: Whether each may have any size.
        cost: Of the devices and their values [nats].
        names: Of the values that differ from device to device, the one that runs in the grid first.
        known: Values of that one that the kind knows for its devices, numbers or of shape (D,);
            empty: a device has one near that of the grid.
    """

    kind: EffectKind
    free: bool
    cost: float
    names: tuple[str, ...]
    known: tuple[Vector | float, ...]

    @property
    def _is_told_again(self) -> bool:
        """Whether values are; what remembers has them told with its states (`device_by_device`)."""
        return bool(self.names) and not self.kind.remembers

    def told(self, sources: Sequence[Course], scorer: Scorer, refined: int) -> Candidate:
        """Evaluate them as they are, and with values that are sought for the first of them.

        A search beside all healthy errors would cost too much, so that what it finds may be worse.

        Args:
            sources: With the values at which that begins.
            scorer: Of what is left to explain.
            refined: How many are sought.
        """
        found = [self._exact(sources, scorer)]
        nearer = list(sources)
        for name in (*self.names, *self.names[:-1]):  # again beside the others
            nearer = self._nearer(nearer, scorer, refined, name)
        if self.names:
            found.append(self._exact(nearer, scorer))
        return max(found, key=lambda one: one.evidence)

    def _exact(self, sources: Sequence[Course], scorer: Scorer) -> Candidate:
        """Evaluate them exactly."""
        kind, law = self.kind, sources[0].law
        chosen = [one.places[0] for one in sources]
        spectrum, patterns = spectrum_of(sources, scorer)
        pull, information = scorer.columns(patterns, spectrum)
        sizes, cost = np.ones(len(chosen)), self.cost
        if self.free:
            terms = NormalTerms(pull, information, np.full(len(chosen), SIZE_WIDTH**2))
            best = zip(sources, terms.mean().tolist(), strict=True)
            sizes = np.array([within(kind, one.values, size) for one, size in best])
            cost += terms.cost(sizes)
        field = (spectrum * np.tile(sizes, len(patterns))) @ np.hstack(patterns).T
        largest = int(np.argmax(np.abs(sizes) * np.sqrt(np.maximum(np.diag(information), 0.0))))
        scaled = dict(sources[largest].values)
        for parameter in kind.sizes:
            scaled[parameter.name] *= float(sizes[largest])
        unit = sources[largest].values[kind.linear] if kind.linear else 1.0
        sized = tuple(
            replace(one, size=np.array([size])) for one, size in zip(sources, sizes, strict=True)
        )
        return Candidate(
            kind, tuple(chosen), tuple(law.names[place] for place in chosen),
            scaled, scorer.likelihood(field) - cost, cost=cost,
            sizes=tuple(float(size * unit) for size in sizes) if self.free else (),
            field=field, sources=sized,
            again=partial(self._again, sources, scorer) if self._is_told_again else None,
        )  # fmt: skip

    def _nearer(
        self, sources: Sequence[Course], scorer: Scorer, refined: int, value: str
    ) -> list[Course]:
        """Seek the values of the first of them in turn, each beside the others."""
        nearer, count = list(sources), len(sources)
        spectrum, patterns = spectrum_of(sources, scorer)
        whole = np.hstack(patterns).T.astype(np.float32)
        for place in range(min(refined, count)):
            others = spectrum.copy()
            others[:, place::count] = 0.0
            late = scorer.rows.without(others @ whole)
            nearer[place] = self._nearest(scorer, nearer[place], late, value)
            spectrum[:, place::count] = spectrum_of(nearer[place : place + 1], scorer)[0]
        return nearer

    def _again(self, sources: Sequence[Course], scorer: Scorer, after: Workspace) -> Candidate:
        """Seek the values of all of them over a floor that was estimated with them.

        Together, as each for itself is right only as far as the others are; one after the other
        where a course does not follow its value in a straight line.
        """
        lower = Scorer.of(over(scorer.space, after))
        now = self._exact(sources, lower)
        for _ in range(NEARER_TURNS):
            steps = [(name, *step_of(now.sources, name, lower)) for name in self.names]
            name, step, promised = max(steps, key=lambda one: one[2])
            if promised < NEARER:
                return now
            nearer = (moved(now.sources, name, share * step) for share in STEPS)
            tried = (self._exact(one, lower) for one in nearer)
            more = next((one for one in tried if one.evidence > now.evidence + NEARER), None)
            if more is None:
                return self.told(now.sources, lower, len(sources))
            now = more
        return now

    def _nearest(self, scorer: Scorer, source: Course, late: Matrix, name: str) -> Course:
        """Search the value of one device on what the others leave: among some, and ever nearer."""
        now, place, signals = source.values.get(name, 0.0), source.places[0], scorer.space.signals
        parameter = next(one for one in self.kind.parameters if one.name == name)
        if now <= 0.0 or (parameter.optional and now == parameter.nominal):
            return source
        first = name == self.names[0]
        reach = OWN_REACH if first else _REACH
        line = now * np.exp(np.linspace(-reach, reach, OWN_VALUES))
        if self.known and first:
            every = len(source.law.names)
            others = [float(np.broadcast_to(one, every)[place]) for one in self.known]
            line = np.unique([now, *(one for one in others if one > 0.0)])
        error = scorer.own_error(self.kind, np.array([place]))
        gain = any_size if scales(self.kind) else given_size

        def worth(values: Vector) -> Vector:
            sets = [source.of(signals, {**source.values, name: float(one)}) for one in values]
            pull, information = np.zeros(len(values)), np.zeros(len(values))
            for block, courses in zip(source.law.patterns, zip(*sets, strict=True), strict=True):
                spectrum = scorer.space.transform.quick_spectrum(np.hstack(courses))
                steps = scorer.space.transform.turn(spectrum)
                part, weight = scorer.rows.weighed(block[:, place], steps, error, late)
                pull, information = pull + part, information + weight
            return gain(pull, information)

        for _ in range(OWN_TURNS):
            best = int(np.argmax(worth(line)))
            now, last = float(line[best]), len(line) - 1
            ends = line[max(best - 1, 0)], line[min(best + 1, last)]
            line = np.unique([now, *np.linspace(*ends, OWN_VALUES)])
        return replace(source, values={**source.values, name: now})
