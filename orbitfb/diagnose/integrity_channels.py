"""Channels with the wrong sign or the wrong name.

The steps of the orbit are compared with what the model makes of the steps of the setpoints, under
fixed alternatives: a sign turned, two names swapped. No slope is fitted. The noise of a reading
is in the action after it and makes a fitted slope wrong, but it makes the right signs and names
look even better than they are: errors are misses, not false alarms.
"""

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.finding import Finding, listed
from orbitfb.diagnose.integrity_steps import Steps, steps_of
from orbitfb.effects.layout import Devices
from orbitfb.effects.record import Record
from orbitfb.physics.optics import Matrix

_SURE = 50.0
"""Log likelihood by which an alternative must win; rows count once, BPMs are not independent."""

_EXPLAINED = 0.7
_MANY = 0.2
_FEWEST = 50
_FEWEST_CHANNELS = 4


def check_channels(record: Record) -> list[Finding]:
    """Find BPMs and correctors with a turned sign or swapped names."""
    steps = steps_of(record)
    # The largest steps hold the evidence, and in them the share of noise is least.
    if len(steps.first) < _FEWEST or not steps.predicted.any():
        return []
    both = _whole(steps)
    if both:
        return both
    bpms, correctors = record.layout.bpms, record.layout.correctors
    found = _bpm_signs(steps, bpms) + _bpm_names(steps, bpms)
    if not found:
        residual = steps.orbit - steps.predicted
        found = _corrector_signs(steps, residual, record.layout.response, correctors)
        found += _corrector_names(steps, residual, record.layout.response, correctors)
    return found


def _whole(steps: Steps) -> list[Finding]:
    """Tell a model whose sign, or whose order of rows, is wrong altogether."""
    count = len(steps.first)
    total = float(np.sum(steps.orbit**2))
    right = float(np.sum((steps.orbit - steps.predicted) ** 2))
    turned = float(np.sum((steps.orbit + steps.predicted) ** 2))
    if turned < _EXPLAINED * total and 0.5 * count * np.log(right / turned) > _SURE:
        text = (
            "the orbit moves against the model: model_R, the setpoints or the orbit have the "
            "wrong sign altogether; turn one of them"
        )
        return [Finding("wrong-sign", "failure", (), None, text)]
    likeness = _likeness(steps)
    own = np.diag(likeness)
    best = likeness.max(axis=1)
    gain = 0.5 * count * np.log((1 - own * np.abs(own)) / (1 - np.minimum(best, 0.999999) ** 2))
    elsewhere = gain > _SURE
    n = len(own)
    if n >= _FEWEST_CHANNELS and elsewhere.sum() >= max(3, _MANY * n):
        targets = likeness.argmax(axis=1)[elsewhere]
        if len(np.unique(targets)) > _EXPLAINED * len(targets):
            text = (
                f"{int(elsewhere.sum())} of {n} BPM columns follow what the model says of other "
                "BPMs: columns of 'orbit' are not in the order of bpm_names and model_R"
            )
            return [Finding("permuted-channels", "failure", (), None, text)]
    return []


def _likeness(steps: Steps) -> Matrix:
    """Correlation of the step of every BPM with what the model says of every other, (n, n)."""
    seen = np.sqrt(np.sum(steps.orbit**2, axis=0))
    made = np.sqrt(np.sum(steps.predicted**2, axis=0))
    scale = np.outer(np.where(seen > 0, seen, np.inf), np.where(made > 0, made, np.inf))
    return (steps.orbit.T @ steps.predicted) / scale


def _bpm_signs(steps: Steps, bpms: Devices) -> list[Finding]:
    count = len(steps.first)
    seen = np.sum(steps.orbit**2, axis=0)
    right = np.sum((steps.orbit - steps.predicted) ** 2, axis=0)
    turned = np.sum((steps.orbit + steps.predicted) ** 2, axis=0)
    moved = seen > 0
    gain = np.zeros(len(seen))
    gain[moved] = 0.5 * count * np.log(right[moved] / turned[moved])
    hit = (gain > _SURE) & (turned < _EXPLAINED * seen)
    return _told(
        hit,
        bpms,
        "bpm-polarity",
        "reads with the wrong sign: its steps are those of the model, turned",
    )


def _bpm_names(steps: Steps, bpms: Devices) -> list[Finding]:
    """Find pairs of BPMs that each read what the model says of the other."""
    count, n = steps.orbit.shape
    cross = steps.orbit.T @ steps.predicted
    seen = np.sum(steps.orbit**2, axis=0)
    made = np.sum(steps.predicted**2, axis=0)
    left = seen[:, None] - 2 * cross + made[None, :]
    own = np.diag(left)
    # Against a gain of its own, so that a wrong gain is no swap.
    slope = np.divide(np.diag(cross), made, out=np.zeros(n), where=made > 0)
    scaled = seen - slope * np.diag(cross)
    usable = (own > 0) & (scaled > 0)
    if usable.sum() < 2:
        return []
    reach = np.where(usable, np.minimum(own, scaled), np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        gain = 0.5 * count * np.log(reach[:, None] / np.maximum(left, 1e-300))
    gain[~np.isfinite(gain)] = -np.inf
    good = (gain > _SURE) & (left < _EXPLAINED * seen[:, None])
    pairs = np.argwhere(np.triu(good & good.T, 1))
    mutual = [(int(i), int(j)) for i, j in pairs
              if gain[i].argmax() == j and gain[j].argmax() == i]  # fmt: skip
    return [
        Finding(
            "swapped-bpms",
            "warning",
            (bpms.label(i), bpms.label(j)),
            None,
            f"{bpms.label(i)} and {bpms.label(j)} each read what the model says of the other: "
            "their cables or names are swapped",
            effect="bpm-swap",
        )
        for i, j in mutual
    ]


def _corrector_signs(
    steps: Steps, residual: Matrix, response: Matrix, correctors: Devices
) -> list[Finding]:
    pull, size = _scores(steps, residual, response)
    slope = np.divide(pull, size, out=np.zeros(len(pull)), where=size > 0)
    gain = -2.0 * (pull + size)
    hit = (gain > _SURE) & (slope < -1.5) & (slope > -2.6)
    return _told(
        hit,
        correctors,
        "corrector-polarity",
        "acts with the wrong sign: the orbit steps against the model with it",
    )


def _corrector_names(
    steps: Steps, residual: Matrix, response: Matrix, correctors: Devices
) -> list[Finding]:
    """Find pairs of correctors that each act where the model has the other."""
    weights = _weights(residual)
    scores = (residual * weights @ response).T @ steps.setpoints
    overlap = response.T @ (weights[:, None] * response)
    moves = steps.setpoints.T @ steps.setpoints
    own = np.diag(scores)
    pull = own[:, None] - scores - scores.T + own[None, :]
    apart = np.diag(overlap)[:, None] - 2 * overlap + np.diag(overlap)[None, :]
    travel = np.diag(moves)[:, None] - 2 * moves + np.diag(moves)[None, :]
    gain = -pull - 0.5 * apart * travel
    size = np.diag(overlap) * np.diag(moves)
    alone = np.divide(own**2, 2 * size, out=np.zeros(len(own)), where=size > 0)
    gain -= alone[:, None] + alone[None, :]
    np.fill_diagonal(gain, -np.inf)
    best = gain.argmax(axis=1)
    return [
        Finding(
            "swapped-correctors",
            "warning",
            (correctors.label(i), correctors.label(int(j))),
            None,
            f"{correctors.label(i)} and {correctors.label(int(j))} each act where the model has "
            "the other: their cables or names are swapped",
            effect="corrector-swap",
        )
        for i, j in enumerate(best)
        if i < j and best[j] == i and gain[i, j] > _SURE
    ]


def _scores(steps: Steps, residual: Matrix, response: Matrix) -> tuple[Vector, Vector]:
    """Project what is left on what every corrector alone makes, and size of the latter, (m,)."""
    weights = _weights(residual)
    pull = np.sum((residual * weights @ response) * steps.setpoints, axis=0)
    size = np.sum(response**2 * weights[:, None], axis=0) * np.sum(steps.setpoints**2, axis=0)
    return pull, size


def _weights(residual: Matrix) -> Vector:
    """One over the variance of every BPM, and over the number of BPMs: rows count once."""
    variance = np.mean(residual**2, axis=0)
    weights = np.divide(1.0, variance, out=np.zeros(len(variance)), where=variance > 0)
    return weights / np.sqrt(len(weights))


def _told(hit: Mask, devices: Devices, effect: str, text: str) -> list[Finding]:
    """Name channels with a turned sign; many of them have another cause."""
    names = [devices.label(int(i)) for i in np.flatnonzero(hit)]
    if not names:
        return []
    if len(names) > max(2, _MANY * len(devices)):
        many = f"{len(names)} devices ({listed(names)}) seem to have the wrong sign at once"
        return [Finding(effect, "note", tuple(names), None, many)]
    return [
        Finding(effect, "warning", (name,), None, f"{name} {text}", effect=effect) for name in names
    ]
