"""Devices of one law, fitted with values of each one's own."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.ranking import any_size, scales, within
from orbitfb.diagnose.hypotheses.refit import Course, moved, spectrum_of, step_of
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.corrected import over
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind
from orbitfb.estimation.evidence import NormalTerms, given_size
from orbitfb.estimation.priors import (
    NEARER,
    NEARER_TURNS,
    OWN_REACH,
    OWN_TURNS,
    OWN_VALUES,
    SIZE_WIDTH,
    STEPS,
)
from orbitfb.estimation.transform import Matrix

_REACH = float(np.log(4.0))
"""Logarithm of the ratio within which a value is sought that hardly differs within a grid. By hand:
a grid has one or two of them."""


@dataclass(frozen=True, slots=True, eq=False)
class OwnFit:
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
