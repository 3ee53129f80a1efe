"""Does the orbit answer as the response matrix says? A wrong sign or permuted BPMs do not.

Let p_k be the answer predicted for the change that was written at tick k, d_k the step of the
orbit from tick k to k + 1. With steady drift w the step is d_k = c p_k + w, so that

    c = Δd · Δp / Δp²,   Δ: difference between two ticks that follow each other,

is 1 for the right matrix, −1 for one of the wrong sign and about 0 for permuted BPMs, whatever
drifts. Disturbances only make it larger: the loop answers an orbit error e by p = −g e, and the
step of a disturbance that is corrected one tick later enters Δd · Δp with a positive sign.

An actuator may need some ticks, so that the best of a few lags counts. A matrix is called wrong
only if the orbit error does not shrink either.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.core.values import replace
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.verdict import FINE, Action, Verdict

OTHERWISE = 3.0
"""How many times the predicted answer the beam may move before it says nothing about R."""


@dataclass(frozen=True)
class Answers:
    """What was predicted and what was seen, over the last ticks.

    Args:
        predicted: Answers p predicted for the changes at the last ticks, newest first, each of
            shape (n,) [m].
        position: The orbit before, shape (n,) [m]; None before the first.
        step: The step that led to it, shape (n,) [m]; None before the second.
        valid: BPMs that counted in both, shape (n,).
        wrong: Orbits in a row that did not answer.
        rms: Of the orbit error when they began [m].
    """

    predicted: tuple[Vector, ...] = ()
    position: Vector | None = None
    step: Vector | None = None
    valid: Mask | None = None
    wrong: int = 0
    rms: float = float("inf")


def answered(
    position: Vector, valid: Mask, rms: float, memory: Answers, settings: InterlockSettings
) -> tuple[Verdict, Answers]:
    """Compare the step of the orbit with what was predicted for it.

    Args:
        position: The orbit, shape (n,) [m].
        valid: BPMs that count, shape (n,).
        rms: Of the orbit error [m].
        memory: What `predict` returned after the last tick.
        settings: Thresholds.
    """
    after = seen(position, valid, memory)
    if memory.step is None or memory.valid is None or after.step is None:
        return FINE, after
    counts = valid & memory.valid
    share = _share((after.step - memory.step)[counts], memory.predicted, counts, settings)
    wrong, start = memory.wrong, memory.rms
    if share is not None:
        right = share >= settings.prediction_least
        start = rms if wrong == 0 else start
        wrong = 0 if right else wrong + 1
    after = replace(after, wrong=wrong, rms=start)
    if not 0 < settings.prediction_ticks <= wrong or rms < start or share is None:
        return FINE, after
    reason = (
        f"the orbit does not answer as the response matrix says: {share:.2g} of what was "
        f"predicted, {wrong} times in a row, while the error went from {start * 1e6:.3g} to "
        f"{rms * 1e6:.3g} µm rms; wrong sign, wrong matrix or exchanged BPMs"
    )
    return Verdict(Action.TRIP, "prediction", reason), after


def seen(position: Vector, valid: Mask, memory: Answers) -> Answers:
    """Remember an orbit.

    Args:
        position: The orbit, shape (n,) [m].
        valid: BPMs that count, shape (n,).
        memory: So far.
    """
    step = None if memory.position is None else position - memory.position
    return replace(memory, position=position, step=step, valid=valid)


def idle(position: Vector, valid: Mask, memory: Answers) -> Answers:
    """Remember an orbit of a loop that does not write: nothing is expected of it.

    Args:
        position: The orbit, shape (n,) [m].
        valid: BPMs that count, shape (n,).
        memory: So far.
    """
    step = seen(position, valid, memory).step
    return Answers(position=position, step=step, valid=valid)


def predict(answer: Vector, memory: Answers, settings: InterlockSettings) -> Answers:
    """Remember what the change of this tick should do.

    Args:
        answer: R times the change, shape (n,) [m].
        memory: What `answered` returned.
        settings: How many ticks an actuator may need.
    """
    return replace(memory, predicted=(answer, *memory.predicted[: settings.readback_lag + 1]))


def _share(
    change: Vector, predicted: Sequence[Vector], counts: Mask, settings: InterlockSettings
) -> float | None:
    """Give the part of the predicted answer that was seen, the best of all lags.

    Before the first prediction nothing was sent. None while all are too small to tell, or what
    was seen is so much larger that something else must have moved the beam.
    """
    if not predicted or not change.size:
        return None
    shares: list[float] = []
    largest = float(change @ change)
    sent = (*predicted, np.zeros_like(predicted[0]))[: settings.readback_lag + 2]
    for newer, older in pairwise(sent):
        expected = (newer - older)[counts]
        power = float(expected @ expected)
        if power < change.size * settings.prediction_floor**2:
            continue
        share = float(change @ expected) / power
        if share >= settings.prediction_least or largest <= OTHERWISE**2 * power:
            shares.append(share)
    return max(shares, default=None)
