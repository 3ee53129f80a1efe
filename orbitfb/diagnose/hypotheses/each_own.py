"""Some devices with the same law and values of each one's own."""

from functools import partial

import numpy as np

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.onsets.every import every, shown_together
from orbitfb.diagnose.hypotheses.own_fit import OwnFit
from orbitfb.diagnose.hypotheses.ranking import Ranked, cost_of, needles, scales
from orbitfb.diagnose.hypotheses.refit import Course
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.hypotheses.sets import grown_apart
from orbitfb.diagnose.likelihood.seen import semidefinite
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.laws import DeviceLaw
from orbitfb.estimation.evidence import NormalTerms
from orbitfb.estimation.priors import (
    HOPE,
    MOST_REFINED,
    SCATTERED,
    VALUE_COST,
)


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
    its = OwnFit(
        kind, free, sum(_cost(kind, scorer, rank, number, one) for one in chosen),
        tuple(logs) if len(rank.alone) > 1 else (),
        tuple(own[logs[0]] for own in rank.own if logs[0] in own) if logs else (),
    )  # fmt: skip
    return its.told(sources, scorer, MOST_REFINED)
