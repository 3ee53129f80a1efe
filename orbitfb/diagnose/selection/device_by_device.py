"""What devices that remember held when the record began, and how wide the play of each one is.

A play, say, stands anywhere between its two ends until the setpoint has moved by its width, and
when it begins to move depends on where. A law that begins in the middle leaves jumps of all its
devices, and a width that is wrong. So the states are sought device by device, each between −1 and
1, and the value that runs in the grid with them; all states alike are possible before. They are
sought again beside healthy errors that follow what the devices have, not what they were asked for.

Then each device gets a value of its own, if that explains more than it costs. A course does not
follow its value in a straight line for long, so that the scatter is told here, and not by columns
of derivatives. It is normal in the logarithm of the value, with a variance that the record tells.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.device_laws import evaluated
from orbitfb.diagnose.hypotheses.ranking import cost_of
from orbitfb.diagnose.hypotheses.refit import Course
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.corrected import over
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.levels import courses_of, likeliest, weighed
from orbitfb.estimation.maxima import highest
from orbitfb.estimation.priors import (
    FINENESS,
    FIRST_STATES,
    NEARER,
    NEARER_TURNS,
    SLOPE,
    SURE,
    VALUE_SCATTER,
    WIDER,
)
from orbitfb.estimation.transform import Matrix

_FURTHEST = float(np.log(2.0))
"""Logarithm by which a value moves in a step, at most: courses are not straight for longer."""

_UNIFORM = 1.0 / 3.0
"""Variance of what is anywhere between −1 and 1 with the same probability."""


def device_by_device(one: Candidate, space: Workspace) -> Candidate:
    """Let states and own values of a candidate be told over a floor that was estimated with it.

    Args:
        one: A candidate; what does not remember, begins late or has values of every device's own
            stays as it is.
        space: That it was tried on.
    """
    kind = one.kind
    if not kind.remembers or one.onset or len(one.sources) != 1 or one.again is not None:
        return one

    def told_over(found: Candidate, lower: Scorer, beside: Scorer) -> Candidate:
        near = _nearest(found, lower, cost_of(kind, one.values, lower), beside)
        told = lower.likelihood(np.asarray(near.field))
        return replace(near, cost=told - near.evidence, again=partial(again, near))

    def first(after: Workspace) -> Candidate:
        lower = Scorer.of(over(space, after))
        cost = cost_of(kind, one.values, lower)
        widest = next(p.high for p in kind.fitted(space.signals.record) if p.log)
        return told_over(_wider(one, widest, lower, cost), lower, lower)

    def again(found: Candidate, after: Workspace) -> Candidate:
        lower = over(space, after)
        errors = found.driving(lower)  # follow what its devices have, but the law what was asked
        beside = replace(errors, signals=lower.signals, courses=lower.courses)
        return told_over(found, Scorer.of(lower), Scorer.of(beside.with_noise(after.noise)))

    return replace(one, again=first)


def _name(one: Candidate) -> str:
    """The value that is sought with the states: the one that has a logarithm."""
    return next(p.name for p in one.kind.parameters if p.log)


def _wider(one: Candidate, most: float, scorer: Scorer, cost: float) -> Candidate:
    """The best of a candidate at its value, at a smaller one, and at larger ones.

    It ends with the second larger value in a row that is worse.
    """
    now = one.sources[0].values[_name(one)]
    found: list[Candidate] = []
    for value in sorted({min(factor * now, max(most, now)) for factor in WIDER}):
        found.append(_told(one, value, scorer, cost))
        best = max(found, key=lambda its: its.evidence)
        if value > now and not any(best is its for its in found[-2:]):
            break
    return max(found, key=lambda its: its.evidence)


def _told(one: Candidate, now: float, scorer: Scorer, cost: float) -> Candidate:
    """A candidate near a value of what has a logarithm, and the states that go with it."""
    name = _name(one)
    source = one.sources[0]
    source = replace(source, values={**source.values, name: now})
    levels = np.linspace(-1.0, 1.0, FIRST_STATES)
    first, chosen = _states(source, levels[:, None], scorer)
    at = partial(_at, one, scorer, cost, first=first)
    root = float(np.sqrt(WIDER[1] / WIDER[0]))
    best = highest(lambda value: at(value).evidence, (now / root, now * root), FINENESS)
    found = max(at(now), at(best), key=lambda its: its.evidence)
    return replace(found, evidence=found.evidence - chosen)


def _at(
    one: Candidate, scorer: Scorer, cost: float, value: float, first: Vector | None
) -> Candidate:
    """A candidate at a value of what has a logarithm, with states (k,)."""
    source = one.sources[0]
    source = replace(source, values={**source.values, _name(one): value}, first=first)
    return _of(one, source, scorer, cost)


def _of(one: Candidate, source: Course, scorer: Scorer, cost: float) -> Candidate:
    """A candidate with other states, value, and own values."""
    return evaluated(
        one.kind, source.law, scorer, one.places, source.values, 0, True, cost,
        first=source.first, own=source.own,
    )  # fmt: skip


def _nearest(one: Candidate, scorer: Scorer, cost: float, beside: Scorer) -> Candidate:
    """Tell states and values as finely as the record does.

    Args:
        one: With states.
        scorer: Over which its evidence is told.
        cost: Of its values [nats].
        beside: Over which they are sought.
    """

    def told(near: Candidate, more: float) -> Candidate:
        found = _of(one, near.sources[0], scorer, cost)
        return replace(found, evidence=found.evidence - more)

    near, name, alike = _of(one, one.sources[0], beside, cost), _name(one), None
    if not one.sources[0].own:
        near, chosen = _sought(near, name, beside, cost)
        alike = told(near, chosen)
        if len(near.sources[0].size) == 1:
            return alike
    unlike = told(*_sought(near, name, beside, cost, VALUE_SCATTER))
    return unlike if alike is None or unlike.evidence > alike.evidence + SURE else alike


def _sought(
    near: Candidate, name: str, scorer: Scorer, cost: float, scatter: float = 0.0
) -> tuple[Candidate, float]:
    """Seek the states, and the value or values, and tell what they cost [nats].

    Where in the record a device begins to move changes with its state, so that there are many
    states near which none is better: after a step towards better ones finer levels are tried of
    each device. So it is with values.

    Args:
        near: Where it begins.
        name: Of the value.
        scorer: Of what is left to explain.
        cost: Of its values [nats].
        scatter: Of the logarithms of the devices' own values; 0: they have one.
    """
    reach, chosen = 2.0 / (FIRST_STATES - 1), 0.0
    line = np.linspace(-1.0, 1.0, FIRST_STATES)[:, None]
    for _ in range(NEARER_TURNS):
        source = near.sources[0]
        if scatter:
            source = _own(source, name, 2.0 * reach * VALUE_SCATTER, scorer)
        source, chosen, scatter = _nearer(source, name, scorer, scatter)
        levels = np.clip(_held(source) + reach * line, -1.0, 1.0)
        more = _of(near, replace(source, first=_states(source, levels, scorer)[0]), scorer, cost)
        if more.evidence < near.evidence + NEARER:
            break
        near, reach = more, 0.5 * reach
    return near, chosen


def _held(source: Course) -> Vector:
    """States of its devices in the first row, shape (k,)."""
    return np.zeros(len(source.size)) if source.first is None else source.first


def _times(source: Course, name: str, factor: Vector | float) -> Course:
    """The same with other values, one for all or of each; the devices stay where they are."""
    first = np.clip(_held(source) / factor, -1.0, 1.0)
    if isinstance(factor, float):
        values = {**source.values, name: factor * source.values[name]}
        return replace(source, values=values, first=first)
    own = factor * source.own.get(name, np.ones(len(first)))
    middle = float(np.exp(np.mean(np.log(own))))
    values = {**source.values, name: middle * source.values[name]}
    return replace(source, values=values, first=first, own={**source.own, name: own / middle})


def _own(source: Course, name: str, reach: float, scorer: Scorer) -> Course:
    """Choose the likeliest value of every device among some on both sides of that it has."""
    factors = np.exp(reach * np.linspace(-1.0, 1.0, FIRST_STATES))
    several = [courses_of(_times(source, name, factor), scorer) for factor in factors]
    number, _ = likeliest(*weighed(source, several, scorer))
    return _times(source, name, factors[number])


def _nearer(
    source: Course, name: str, scorer: Scorer, scatter: float
) -> tuple[Course, float, float]:
    """Go a step of Gauss and Newton, to better states and a better value, or values.

    A state is anywhere within the play with the same probability; what is known of it is told as
    that of a normal one of the same variance. Where nothing shows, state and value stay.

    Args:
        source: With the value and the states.
        name: Of the value.
        scorer: Of what is left to explain.
        scatter: Of the logarithms of the devices' own values; 0: they have one.

    Returns:
        The course, what its states and own values cost [nats], and the scatter as it shows.
    """
    count, first = len(source.size), _held(source)
    low, high = np.maximum(first - SLOPE, -1.0), np.minimum(first + SLOPE, 1.0)
    by_state = [
        (after - before) / (high - low)
        for after, before in zip(
            courses_of(replace(source, first=high), scorer),
            courses_of(replace(source, first=low), scorer),
            strict=True,
        )
    ]
    by_value = [
        (after - before) / (2.0 * SLOPE)
        for after, before in zip(
            courses_of(_times(source, name, 1.0 + SLOPE), scorer),
            courses_of(_times(source, name, 1.0 - SLOPE), scorer),
            strict=True,
        )
    ]
    several = [by_state, by_value, courses_of(source, scorer)]
    pull, information = weighed(source, several, scorer)
    left = (pull - information[:, :, 2].sum(axis=2))[:2].reshape(-1)  # beside what is there already
    inner = information[:2, :, :2].reshape(2 * count, 2 * count)
    apart, one_for_all = np.log(source.own.get(name, np.ones(count))), not scatter
    values = 1 if one_for_all else count
    sums = np.zeros((count + values, 2 * count))
    sums[np.arange(count), np.arange(count)] = 1.0
    sums[count + np.arange(count) % values, count + np.arange(count)] = 1.0
    left, inner = sums @ left, sums @ inner @ sums.T
    width = _FURTHEST if one_for_all else scatter
    variance = np.append(np.full(count, _UNIFORM), np.full(values, width**2))
    precise = inner + np.diag(1.0 / variance)
    step = np.linalg.solve(precise, left - np.append(first, apart[:values]) / variance)
    factor = np.exp(np.clip(step[count:], -_FURTHEST, _FURTHEST))
    states = np.clip(first + step[:count], -1.0, 1.0)
    told = slice(count if one_for_all else None)
    wide = np.eye(len(inner[told])) + variance[told, None] * inner[told, told]
    cost = 0.5 * float(np.linalg.slogdet(wide)[1])
    if one_for_all:
        return _times(replace(source, first=states), name, float(factor[0])), cost, 0.0
    moved = _times(replace(source, first=states), name, factor)
    apart = np.log(moved.own[name])
    cost += 0.5 * float(np.sum((apart / scatter) ** 2))
    known = np.diag(np.linalg.inv(precise))[count:]
    return moved, cost, float(np.sqrt(np.mean(apart**2 + known)))


def _states(source: Course, levels: Matrix, scorer: Scorer) -> tuple[Vector, float]:
    """The likeliest state of every device, shape (k,), and what choosing them costs [nats].

    Args:
        source: With the values.
        levels: That are tried, of all devices (L, 1) or of each (L, k).
        scorer: Of what is left to explain.
    """
    each = np.broadcast_to(levels, (len(levels), len(source.size)))
    several = [courses_of(replace(source, first=one), scorer) for one in each]
    state, gain = likeliest(*weighed(source, several, scorer))
    best = gain.max(axis=0)
    cost = -np.log(np.mean(np.exp(gain - best), axis=0))
    return each[state, np.arange(len(state))], float(cost.sum())
