"""What devices that remember held when the record began.

A play, say, stands anywhere between its two ends until the setpoint has moved by its width, and
when it begins to move depends on where. A law that begins in the middle leaves jumps of all its
devices, and a width that is wrong. So the states are sought device by device, each between −1 and
1, and the value that runs in the grid with them; all states alike are possible before. They are
sought again beside healthy errors that follow what the devices have, not what they were asked for.
"""

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.device_laws import evaluated, highest
from orbitfb.diagnose.hypotheses.ranking import cost_of
from orbitfb.diagnose.hypotheses.refit import Course
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.corrected import over
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.estimation.priors import (
    FINENESS,
    FIRST_STATES,
    NEARER,
    NEARER_TURNS,
    PARTNERS,
    SLOPE,
    WIDER,
)
from orbitfb.estimation.transform import Indices, Matrix

_FURTHEST = float(np.log(2.0))
"""Logarithm by which a value moves in a step, at most: courses are not straight for longer."""

_UNIFORM = 1.0 / 3.0
"""Variance of what is anywhere between −1 and 1 with the same probability."""


def with_first_states(one: Candidate, space: Workspace) -> Candidate:
    """Let the states of a candidate be told once there is a floor that was estimated with it.

    Args:
        one: A candidate; what does not remember, begins late or has values of every device's own
            stays as it is.
        space: That it was tried on.
    """
    kind = one.kind
    if not kind.remembers or one.onset or len(one.sources) != 1 or one.again is not None:
        return one

    def weighed(found: Candidate, lower: Scorer, beside: Scorer) -> Candidate:
        near = _nearest(found, lower, cost_of(kind, one.values, lower), beside)
        told = lower.likelihood(np.asarray(near.field))
        return replace(near, cost=told - near.evidence, again=partial(again, near))

    def first(after: Workspace) -> Candidate:
        lower = Scorer.of(over(space, after))
        cost = cost_of(kind, one.values, lower)
        widest = next(p.high for p in kind.fitted(space.signals.record) if p.log)
        return weighed(_wider(one, widest, lower, cost), lower, lower)

    def again(found: Candidate, after: Workspace) -> Candidate:
        lower = over(space, after)
        errors = found.driving(lower)  # follow what its devices have, but the law what was asked
        beside = replace(errors, signals=lower.signals, courses=lower.courses)
        return weighed(found, Scorer.of(lower), Scorer.of(beside.with_noise(after.noise)))

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
    values = {**one.sources[0].values, _name(one): value}
    law = one.sources[0].law
    return evaluated(one.kind, law, scorer, one.places, values, 0, True, cost, first=first)


def _nearest(one: Candidate, scorer: Scorer, cost: float, beside: Scorer) -> Candidate:
    """Tell states and value as finely as the record does.

    Where in the record a device begins to move changes with its state, so that there are many
    states near which none is better: after a step towards better ones finer levels are tried of
    each device.

    Args:
        one: With states.
        scorer: Over which its evidence is told.
        cost: Of its values [nats].
        beside: Over which they are sought.
    """
    name, reach = _name(one), 2.0 / (FIRST_STATES - 1)
    near = _at(one, beside, cost, one.sources[0].values[name], one.sources[0].first)
    chosen = 0.0
    for _ in range(NEARER_TURNS):
        value, states, chosen = _nearer(near.sources[0], name, beside)
        source = replace(near.sources[0], values={**near.sources[0].values, name: value})
        levels = np.clip(states + reach * np.linspace(-1.0, 1.0, FIRST_STATES)[:, None], -1.0, 1.0)
        more = _at(one, beside, cost, value, _states(source, levels, beside)[0])
        if more.evidence < near.evidence + NEARER:
            break
        near, reach = more, 0.5 * reach
    found = _at(one, scorer, cost, near.sources[0].values[name], near.sources[0].first)
    return replace(found, evidence=found.evidence - chosen)


def _nearer(source: Course, name: str, scorer: Scorer) -> tuple[float, Vector, float]:
    """Go a step of Gauss and Newton: the value, the states (k,), and what the states cost [nats].

    A state is anywhere within the play with the same probability; what is known of it is told as
    that of a normal one of the same variance. Where nothing shows, state and value stay.

    Args:
        source: With the value and the states.
        name: Of the value.
        scorer: Of what is left to explain.
    """
    count, now = len(source.size), source.values[name]
    first = np.zeros(count) if source.first is None else source.first

    def courses(states: Vector, factor: float) -> list[Matrix]:
        values = {**source.values, name: factor * now}
        return _courses(replace(source, values=values), states, scorer)

    low, high = np.maximum(first - SLOPE, -1.0), np.minimum(first + SLOPE, 1.0)
    by_state = [
        (after - before) / (high - low)
        for after, before in zip(courses(high, 1.0), courses(low, 1.0), strict=True)
    ]
    by_value = [  # the devices stay where they are
        (after - before) / (2.0 * SLOPE)
        for after, before in zip(
            courses(np.clip(first / (1.0 + SLOPE), -1.0, 1.0), 1.0 + SLOPE),
            courses(np.clip(first / (1.0 - SLOPE), -1.0, 1.0), 1.0 - SLOPE),
            strict=True,
        )
    ]
    pull, information = _weighed(source, [by_state, by_value, courses(first, 1.0)], scorer)
    left = pull - information[:, :, 2].sum(axis=2)  # beside what is there already
    states, value = 0, 1
    inner = np.empty((count + 1, count + 1))
    inner[:count, :count] = information[states, :, states]
    inner[:count, count] = inner[count, :count] = information[states, :, value].sum(axis=1)
    inner[count, count] = information[value, :, value].sum() + 1.0 / _FURTHEST**2
    inner[np.diag_indices(count)] += 1.0 / _UNIFORM
    step = np.linalg.solve(inner, np.append(left[states] - first / _UNIFORM, left[value].sum()))
    factor = float(np.exp(np.clip(step[count], -_FURTHEST, _FURTHEST)))
    grown = np.eye(count) + _UNIFORM * information[states, :, states]
    cost = 0.5 * float(np.linalg.slogdet(grown)[1])
    return factor * now, np.clip((first + step[:count]) / factor, -1.0, 1.0), cost


def _states(source: Course, levels: Matrix, scorer: Scorer) -> tuple[Vector, float]:
    """The likeliest state of every device, shape (k,), and what choosing them costs [nats].

    Args:
        source: With the values.
        levels: That are tried, of all devices (L, 1) or of each (L, k).
        scorer: Of what is left to explain.
    """
    each = np.broadcast_to(levels, (len(levels), len(source.size)))
    pull, information = _weighed(source, [_courses(source, one, scorer) for one in each], scorer)
    state, gain = _chosen(pull, information)
    best = gain.max(axis=0)
    cost = -np.log(np.mean(np.exp(gain - best), axis=0))
    return each[state, np.arange(len(state))], float(cost.sum())


def _courses(source: Course, states: Vector, scorer: Scorer) -> list[Matrix]:
    """Courses of the devices with given states, block by block, shape (N, k) each."""
    courses = replace(source, first=states).of(scorer.space.signals, source.values)
    return [np.broadcast_to(one, (len(one), len(source.size))) * source.size for one in courses]


def _weighed(
    source: Course, several: list[list[Matrix]], scorer: Scorer
) -> tuple[Matrix, NDArray[np.float64]]:
    """Pull (L, k) and information (L, k, L, k) of L courses of every device.

    Args:
        source: Whose devices they are.
        several: The courses, L times block by block, shape (N, k) each.
        scorer: Of what is left to explain.
    """
    count, size = len(several), len(source.size)
    chosen = list(source.places) if source.places else slice(None)
    patterns = [one[:, chosen] for one in source.law.patterns]
    turned = scorer.space.transform.quick_spectrum
    spectrum = np.hstack([turned(one) for level in several for one in level])
    pull, information = scorer.columns(patterns, spectrum)
    return pull.reshape(count, size), information.reshape(count, size, count, size)


def _chosen(pull: Matrix, information: NDArray[np.float64]) -> tuple[Indices, Matrix]:
    """Numbers of the best levels of devices, shape (k,), and what each level gains, (L, k).

    One device after the other, then each with those that act most like it: what one of two that
    are alike has too much, the other has too little, and neither is better for itself.

    Args:
        pull: Shape (L, k).
        information: Of all pairs, shape (L, k, L, k).
    """
    count = pull.shape[1]
    own = np.einsum("lklk->lk", information)
    middle, devices = len(pull) // 2, np.arange(count)
    state = np.full(count, middle)
    usual = np.sqrt(np.maximum(own[middle], 1e-300))
    alike = np.abs(information[middle, :, middle]) / np.outer(usual, usual)
    alike[devices, devices] = -1.0
    partners = np.argsort(-alike, axis=1)[:, :PARTNERS]
    total = information[:, :, state, devices].sum(axis=2)
    gain, alone = np.zeros_like(pull), pull - 0.5 * own
    for _ in range(len(pull)):
        before = state.copy()
        for one in devices:
            for other in (one, *partners[one]):
                both = [one] if other == one else [one, other]
                rest = total[:, both] - sum(information[:, both, state[its], its] for its in both)
                gains = (alone[:, both] - rest).T
                if other == one:
                    gain[:, one] = gains[0]
                    found = (int(np.argmax(gains[0])),)
                else:
                    joint = gains[0][:, None] + gains[1] - information[:, one, :, other]
                    found = np.unravel_index(int(np.argmax(joint)), joint.shape)
                for its, level in zip(both, found, strict=True):
                    if level != state[its]:
                        total += information[level, its] - information[state[its], its]
                        state[its] = level
        if np.array_equal(before, state):
            break
    return state, gain
