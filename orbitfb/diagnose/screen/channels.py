"""Channels with the wrong sign or the wrong name.

The steps of the orbit are compared with what the model makes of the steps of the setpoints, under
fixed alternatives: a sign turned, two names swapped. No slope is fitted. The noise of a reading
is in the action after it and makes a fitted slope wrong, but it makes the right signs and names
look even better than they are: errors are misses, not false alarms. One alternative is told, the
one that explains most, and only if it explains a good part of everything that is wrong.
"""

from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.screen.order import check_order
from orbitfb.diagnose.screen.steps import SURE, Steps, few_turned, likelier, one_way, steps_of
from orbitfb.physics.optics import Matrix
from orbitfb.records.finding import Finding
from orbitfb.records.layout import Devices
from orbitfb.records.record import Record

_EXPLAINED = 0.7
_MOST = 0.8
_LIKE_OTHERS = 3.0
_LARGE = 3.0
"""Times the median beyond which a step counts no more."""
_FEWEST = 30
_TRIED = 4
_ROUNDS = 8
_APART = 10.0
"""By so much a BPM that has shown one number only must differ from the others: what is small has
any sign by other errors."""
_ALL = 0.9
"""Share that a turned or swapped corrector explains of what any response to its steps would."""


@dataclass(frozen=True, slots=True)
class _Alternative:
    """Another sign or name, and by how much it wins over the model as it is."""

    gain: float
    kind: str
    columns: tuple[int, ...]


_TEXTS = {
    "bpm-polarity": "reads with the wrong sign: its steps are opposite to those of the model",
    "bpm-swap": "each read what the model predicts for the other: cables or names are swapped",
    "corrector-polarity": "acts with the wrong sign: its steps are opposite to those of the model",
    "corrector-swap": "each act as the model predicts for the other: cables or names are swapped",
}


def check_channels(record: Record) -> list[Finding]:
    """Find BPMs and correctors with a turned sign or swapped names."""
    steps = steps_of(record)
    if len(steps.first) < _FEWEST or not steps.predicted.any():
        return []
    bpms, correctors = record.layout.bpms, record.layout.correctors
    response = record.layout.response
    evened = _evened(steps)
    if whole := _turned(evened, response) or check_order(evened, response):
        return whole
    found: list[Finding] = []
    alternatives = [*_bpms(steps), *_correctors(steps, response)]
    for _ in range(_ROUNDS):
        best = max(alternatives, key=lambda each: each.gain, default=None)
        if best is None:
            return found
        of_bpms = best.kind.startswith("bpm")
        found.append(_told(best, bpms if of_bpms else correctors))
        if not of_bpms:
            return found  # what is left of a corrector is in all BPMs, and looks like others
        orbit = _applied(steps.orbit, best)
        steps = replace(steps, orbit=orbit)
        alternatives = _bpms(steps)
    # Where one correction calls for the next, something else is wrong.
    return []


def _evened(steps: Steps) -> Steps:
    """Scale the largest steps down: where a loop runs away its last rows would say it all.

    They all go one way, that of the device which is wrong, and many alternatives fit that.
    """
    factor = np.ones(len(steps.first))
    for course in (steps.orbit, steps.predicted):
        size = np.sqrt(np.mean(course**2, axis=1))
        if size.any():
            factor = np.maximum(factor, size / (_LARGE * float(np.median(size[size > 0]))))
    even = factor[:, None]
    return Steps(steps.first, steps.orbit / even, steps.setpoints / even, steps.predicted / even)


def _told(best: _Alternative, devices: Devices) -> Finding:
    names = tuple(devices.label(column) for column in best.columns)
    text = f"{' and '.join(names)} {_TEXTS[best.kind]}"
    return Finding("channels", "warning", names, None, text, effect=best.kind)


def _applied(orbit: Matrix, best: _Alternative) -> Matrix:
    """Correct the orbit by an alternative, to look for the next one."""
    columns = list(best.columns)
    orbit = orbit.copy()
    if best.kind == "bpm-polarity":
        orbit[:, columns] *= -1.0
    else:
        orbit[:, columns] = orbit[:, columns[::-1]]
    return orbit


def _turned(steps: Steps, response: Matrix) -> list[Finding]:
    """Tell a model whose sign is wrong altogether."""
    count = len(steps.first)
    turned = np.sum((steps.orbit + steps.predicted) ** 2, axis=0)
    seen = np.sum(steps.orbit**2, axis=0)
    right = few_turned(steps, response)
    against = (turned < _EXPLAINED * seen) & (likelier(count, right, turned) > SURE)
    if against.mean() > _MOST:
        text = (
            "the orbit moves opposite to the model: model_R, 'setpoint' or 'orbit' has the wrong "
            "sign as a whole; reverse the wrong one"
        )
        return [Finding("wrong-sign", "failure", (), None, text)]
    return []


def _bpms(steps: Steps) -> list[_Alternative]:
    """Turned and swapped BPMs that then look like the others."""
    count, n = steps.orbit.shape
    cross = steps.orbit.T @ steps.predicted
    seen = np.sum(steps.orbit**2, axis=0)
    made = np.sum(steps.predicted**2, axis=0)
    own = seen - 2 * np.diag(cross) + made
    usual = _LIKE_OTHERS * float(np.median(own))
    apart = own > (_APART * np.median(own) if one_way(steps) else 0.0)
    turned = seen + 2 * np.diag(cross) + made
    gain = likelier(count, own, turned)
    reversed_ = apart & (gain > SURE) & (turned < usual) & (turned < _EXPLAINED * seen)
    # Against a gain of its own, so that a wrong gain is no swap.
    slope = np.divide(np.diag(cross), made, out=np.zeros(n), where=made > 0)
    reach = np.maximum(np.minimum(own, seen - slope * np.diag(cross)), 0.0)
    left = np.maximum(seen[:, None] - 2 * cross + made[None, :], 0.0)
    gains = likelier(count, np.broadcast_to(reach[:, None], left.shape).copy(), left)
    good = apart[:, None] & (gains > SURE) & (left < usual) & (left < _EXPLAINED * seen[:, None])
    swapped = good & good.T
    # Of two alternatives for a BPM the one that leaves less, whatever each is compared with.
    other = np.broadcast_to(turned[:, None], left.shape).copy()
    better = reversed_[:, None] & (likelier(count, left, other) > SURE)
    worse = reversed_ & np.any(swapped & (likelier(count, other, left) > SURE), axis=1)
    found = [
        _Alternative(float(gain[i]), "bpm-polarity", (int(i),))
        for i in np.flatnonzero(reversed_ & ~worse)
    ]
    for i, j in np.argwhere(np.triu(swapped & ~(better | better.T), 1)):
        both = float(gains[i, j] + gains[j, i])
        found.append(_Alternative(both, "bpm-swap", (int(i), int(j))))
    return found


def _correctors(steps: Steps, response: Matrix) -> list[_Alternative]:
    """Turned and swapped correctors without which much less is left, at most BPMs.

    One that leaves more than another says nothing, even where that other one may be no more than
    gains of its own: while a loop runs away its correctors move in proportion.
    """
    residual = steps.orbit - steps.predicted
    own = np.sum(residual**2, axis=0)
    weights = np.divide(1.0, own, out=np.zeros_like(own), where=own > 0)
    scores = ((residual * weights) @ response).T @ steps.setpoints
    overlap = response.T @ (weights[:, None] * response)
    moves = steps.setpoints.T @ steps.setpoints
    pull, size = np.diag(scores), np.diag(overlap) * np.diag(moves)
    found: list[tuple[_Alternative | None, float]] = []
    turning = -2.0 * (pull + size)
    for j in np.argsort(turning)[-_TRIED:]:
        if turning[j] > 0:
            drive = steps.setpoints[:, j]
            change = 2.0 * np.outer(drive, response[:, j])
            if _all_of(residual, change, drive, weights):
                columns = (int(j),)
                found.append(_judged(steps, own, own, residual + change, columns))
    pulls = pull[:, None] - scores - scores.T + pull[None, :]
    apart = np.diag(overlap)[:, None] - 2 * overlap + np.diag(overlap)[None, :]
    travel = np.diag(moves)[:, None] - 2 * moves + np.diag(moves)[None, :]
    swapping = np.triu(-pulls - 0.5 * apart * travel, 1)
    for flat in np.argsort(swapping, axis=None)[-_TRIED:]:
        j, k = (int(i) for i in np.unravel_index(flat, swapping.shape))
        if swapping[j, k] > 0:
            difference = steps.setpoints[:, j] - steps.setpoints[:, k]
            change = np.outer(difference, response[:, j] - response[:, k])
            rest = np.minimum(own, _with_own_gains(residual, steps, response, weights, (j, k)))
            if _all_of(residual, change, difference, weights):
                found.append(_judged(steps, own, rest, residual + change, (j, k)))
    most = max((explained for _, explained in found), default=0.0)
    return [one for one, explained in found if one is not None and explained > most - SURE]


def _all_of(residual: Matrix, change: Matrix, drive: Vector, weights: Vector) -> bool:
    """Whether a change by these steps is right, and not just better than none.

    Where many correctors move in proportion, whatever is wrong with any of them follows the steps
    of each; only the response of the right one explains all of it.
    """
    before = np.sum(residual**2, axis=0)
    explained = before - np.sum((residual + change) ** 2, axis=0)
    most = (drive @ residual) ** 2 / np.sum(drive**2)
    return float(explained @ weights) > _ALL * float(most @ weights)


def _with_own_gains(
    residual: Matrix, steps: Steps, response: Matrix, weights: Vector, pair: tuple[int, int]
) -> Vector:
    """Squares left at every BPM if both only had gains of their own: a dead one is no swap."""
    patterns = [np.outer(steps.setpoints[:, column], response[:, column]) for column in pair]
    overlap = np.array([[np.sum(a * b * weights) for b in patterns] for a in patterns])
    pull = np.array([np.sum(a * residual * weights) for a in patterns])
    gains = np.linalg.lstsq(overlap, pull, rcond=None)[0]
    left = residual - gains[0] * patterns[0] - gains[1] * patterns[1]
    return np.sum(left**2, axis=0)


def _judged(
    steps: Steps, own: Vector, otherwise: Vector, left: Matrix, columns: tuple[int, ...]
) -> tuple[_Alternative | None, float]:
    """Keep an alternative when most BPMs have much less left with it.

    Args:
        steps: Of the record.
        own: Squares left at every BPM by the model as it is, shape (n,).
        otherwise: The least that gains of these correctors alone would leave, shape (n,).
        left: What the alternative leaves, shape (K, n) [m].
        columns: The corrector that is turned, or the two that are swapped.

    Returns:
        The alternative; None if it is not kept. By how much it wins over the model as it is.
    """
    then = np.sum(left**2, axis=0)
    count, alike = len(steps.first), np.sqrt(len(own))  # neighbouring BPMs see one orbit, not many
    gain = float(np.sum(likelier(count, otherwise, then)) / alike)
    explained = float(np.sum(likelier(count, own, then)) / alike)
    convincing = float(np.median(then / np.where(own > 0, otherwise, np.inf))) < _EXPLAINED
    kind = "corrector-polarity" if len(columns) == 1 else "corrector-swap"
    kept = gain > SURE and convincing
    return (_Alternative(gain, kind, columns) if kept else None), explained
