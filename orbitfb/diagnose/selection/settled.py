"""A candidate that is accepted, with the sizes that it has over the floor that it leaves."""

from dataclasses import replace

import numpy as np

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.random_laws import of_variance, scaled
from orbitfb.diagnose.hypotheses.refit import summed
from orbitfb.diagnose.likelihood.corrected import over
from orbitfb.diagnose.likelihood.weighed import Weighed
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.priors import HEARD, KNOWN_TO, NEARER, SETTLED, SURE
from orbitfb.estimation.transform import Matrix

_TURNS = 8
"""Turns in which the variance of a random cause is told beside the floor that it leaves,
at most. By hand: eight are enough where half of it was in the floor."""
_STEP = float(np.log(4.0))
"""Largest change of the logarithm of a variance in a turn. By hand: twice the size."""
_SOFTER = 0.1
"""Least share of the information of a variance that a floor leaves when it gives way. By
hand."""
_NEARLY = 0.1
"""Square of the standard deviations from its best value within which a variance is told: a
third of one."""
_MAY_COST = 1.0
"""Evidence that telling sizes again may cost [nats]. By hand: floors take up what a size leaves, so
that the readings are about as likely with either."""


def settled(best: Candidate, space: Workspace, spread: bool = True) -> tuple[Candidate, Workspace]:
    """Accept a candidate, with the sizes that it has over the floor that it leaves.

    Sizes are told again over that floor, as long as the readings do not get less likely. Values
    that its devices share are told while they are alike; only then may they differ a little.

    Args:
        best: The candidate.
        space: Without it.
        spread: Whether its values may differ a little from device to device.
    """
    if best.after is not None:  # it begins at the floor that it has already
        space = replace(over(space, best.after), trust=space.trust)
        best = replace(best, after=None)
    # Of one that is only weighed, half of what another cause could be named for is little.
    least = NEARER if spread else 0.5 * SURE
    shared = spread and _is_shared(best)
    best, after = _told_again(best, space, spread and not shared, least)
    if shared:
        best, after = _with_shared_values(best, space, after)
        after = best.accepted(replace(space, noise=after.noise))
    return _sized(best, space, after) if spread else (best, after)


def _told_again(
    best: Candidate, space: Workspace, spread: bool, least: float
) -> tuple[Candidate, Workspace]:
    """Accept a candidate, and tell its sizes over the floor that it leaves, again and again.

    Args:
        best: The candidate.
        space: Without it.
        spread: Whether its values may differ a little from device to device.
        least: Evidence of a change of its sizes below which they stay [nats].
    """
    after = best.accepted(space, spread)
    for _ in range(HEARD):
        if best.again is None or best.field is None:
            break
        more = _told(best, after)
        moved = _weight(np.asarray(more.field) - best.field, after)
        if moved < 2.0 * least:
            break
        little = moved < SETTLED**2 * _weight(best.field, after)
        nearer = more.accepted(replace(space, noise=after.noise), spread)
        if nearer.log_posterior() < after.log_posterior() - _MAY_COST:
            break
        best, after = more, nearer
        if little:
            break
    return best, after


def _is_shared(best: Candidate) -> bool:
    """Whether its devices share values that are told by their courses alone."""
    if len(best.sources) != 1 or best.takes_noise:
        return False
    source = best.sources[0]
    return not source.elements and not source.own and source.first is None


def _with_shared_values(
    best: Candidate, space: Workspace, after: Workspace
) -> tuple[Candidate, Workspace]:
    """Tell the values that its devices share over the floor that it leaves.

    By steps of Gauss and Newton, as long as they make the readings likelier.

    Args:
        best: The cause.
        space: Without it.
        after: With it, its devices all alike.
    """
    bounds = {one.name: (one.low, one.high) for one in best.kind.parameters}
    for _ in range(HEARD):
        # Currents that have the cause already have nothing of it left.
        signals = replace(after.signals, currents=space.signals.currents)
        fields = summed(best.sources[0].columns(best.kind, signals), after.transform)
        if not fields:
            break
        pull, information = Weighed.of(after).evaluate(list(fields.values()))
        inner = information + np.eye(len(fields)) / KNOWN_TO**2
        step = np.linalg.solve(inner, pull)
        if step @ pull - 0.5 * step @ inner @ step < NEARER:
            break
        source, told = best.sources[0], dict(best.values)
        factors = {}
        for name, change in zip(fields, step.tolist(), strict=True):
            low, high = sorted(end / told[name] for end in bounds[name])
            factors[name] = min(max(1.0 + change, 0.5, low), high)
            told[name] *= factors[name]
        values = {name: factors.get(name, 1.0) * one for name, one in source.values.items()}
        moved = replace(source, values=values)
        change = after.transform.spectrum(moved.added(signals) - source.added(signals))
        field = np.asarray(best.field) + change  # it may have a first kick besides
        grown = factors.get(best.kind.linear or "", 1.0)
        sizes = tuple(grown * one for one in best.sizes)
        more = replace(best, sources=(moved,), values=told, sizes=sizes, field=field)
        nearer = more.accepted(replace(space, noise=after.noise), spread=False)
        gain = nearer.log_posterior() - after.log_posterior()
        if gain < NEARER:
            break
        best, after = replace(more, evidence=best.evidence + gain), nearer
    return best, after


def _sized(best: Candidate, space: Workspace, after: Workspace) -> tuple[Candidate, Workspace]:
    """Tell the variance of a random cause beside the floor that it leaves, by secants.

    A floor that was estimated without it has taken part of it, and gives it back turn by turn.

    Args:
        best: The cause.
        space: Without it.
        after: With it.
    """
    before: tuple[float, float] | None = None  # step and score of the turn before
    for _ in range(_TURNS if best.walk is not None or best.white is not None else 0):
        score, slope = of_variance(best, after)
        if before is not None and before[1] != score:
            # What the floor takes of a change is not in the information beside a floor that stays.
            slope = float(np.clip((before[1] - score) / before[0], _SOFTER * slope, slope))
        if score**2 <= _NEARLY * slope or slope <= 0.0:  # where nothing shows of it, it stays
            break
        step = float(np.clip(score / slope, -_STEP, _STEP))
        before = step, score
        noise = _without(best, after.noise, space.noise)
        best = scaled(best, float(np.exp(step)), space)
        after = best.accepted(replace(space, noise=noise))
    return best, after


def _without(best: Candidate, noise: StepNoise, first: StepNoise) -> StepNoise:
    """A floor without a random cause that is in it, beside what shook before."""
    walk = noise.walk if best.walk is None else noise.walk - best.walk
    white = noise.white if best.white is None else noise.white - best.white
    return replace(noise, walk=walk, white=white, shaken=first.shaken)


def _told(one: Candidate, after: Workspace) -> Candidate:
    """The same with the sizes that it has over the floor that it leaves."""
    if one.again is None:
        return one
    more = one.again(after)
    cost = one.cost if more.cost is None else more.cost
    return replace(more, cost=cost, noise_after=one.noise_after)


def _weight(field: Matrix, space: Workspace) -> float:
    """What a field, shape (T, n) [m], weighs under a floor: twice its evidence [nats]."""
    return float(np.sum(space.noise.pull(field, space.transform) * field))
