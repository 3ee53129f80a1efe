"""Setpoints that are not what was sent: clipped, refused, taken back, or moved by somebody.

A put is not acknowledged, so what became of it shows in the readback, in a refusal that the server
tells, and in the setpoints that the machine states when it is asked. One corrector whose puts do
not stay must not pass for a wrong response matrix, nor stop the others: it is left out with its
cause. What happened once, without a cause, was somebody's hand: the loop holds.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.robust import median
from orbitfb.core.signals import Mask, Vector
from orbitfb.core.values import replace
from orbitfb.safety.bounds import Bounds
from orbitfb.safety.interlocks import InterlockSettings

FORGIVEN = 30.0
"""Time after which a setpoint that was not what was sent counts no longer [s]. What takes setpoints
back does so at its scan, every 10 s at most in EPICS base: three of these."""

STRAY = 0.1
"""Share of `readback_tolerance` by which a setpoint may differ from what was sent. A tenth of 0.1 A
is the last digit of a 12 bit converter over ±20 A; what is less is rounding."""


ALONE = 3.0
"""How many times the median a difference must be to stand out: rounding is spread evenly, so that
its largest is twice its median."""


@dataclass(frozen=True)
class Refusals:
    """What is remembered of correctors whose puts do not stay.

    Args:
        missed: When the setpoint of each was not what was sent, monotonic [s], shape (m,); None:
            never.
        found: Correctors that were found not to take puts, with the cause, by index; they have yet
            to be left out.
        causes: Why correctors were left out, by index.
        offset: Readback less setpoint when the setpoints were known last, shape (m,) [A]; NaN where
            not known; None: nowhere.
        beyond: Twice the orbits at which the readback of each said otherwise, less those at which
            it did not since, shape (m,).
    """

    missed: Vector | None = None
    found: Mapping[int, str] = field(default_factory=dict[int, str])
    causes: Mapping[int, str] = field(default_factory=dict[int, str])
    offset: Vector | None = None
    beyond: NDArray[np.int64] | None = None


@dataclass(frozen=True, slots=True)
class Judged:
    """What became of the setpoints that are not what was sent.

    Args:
        moved: Those that somebody moved, for all one knows, shape (m,).
        refusals: What to remember.
    """

    moved: Mask
    refusals: Refusals


def tolerance_of(settings: InterlockSettings) -> float:
    """Give by how much a setpoint may differ from what was sent [A]."""
    return STRAY * (settings.readback_tolerance or 0.0)


def closely(differences: Vector, response: Vector, settings: InterlockSettings) -> Vector:
    """Give by how much each setpoint may differ while the response is about to be called wrong.

    Less than `prediction_floor` at the BPMs cannot explain an answer that was missed; and it is one
    corrector that is looked for, not the rounding of all.

    Args:
        differences: Setpoints less what was sent, shape (m,) [A].
        response: R, shape (n, m) [m/A].
        settings: Thresholds.

    Returns:
        Shape (m,) [A].
    """
    sizes = np.sqrt(np.mean(response**2, axis=0))
    telling = settings.prediction_floor / np.maximum(sizes, np.finfo(np.float64).tiny)
    return np.maximum(telling, ALONE * median(np.abs(differences)))


def judge(
    other: Mask,
    stated: Vector,
    sent: Vector,
    bounds: Bounds,
    told: Mapping[int, str],
    refusals: Refusals,
    now: float,
    settings: InterlockSettings,
) -> Judged:
    """Say why setpoints are not what was sent.

    One that lies at a drive limit, which what was sent is beyond, was clipped: the limit holds from
    now on, and nothing is wrong. One whose put was refused, or that is not what was sent for the
    second time, does not take puts. Where that happens to more than may be lost at once, it is no
    single corrector: puts were lost on their way, or somebody sets them all.

    Args:
        other: Setpoints of ours that are not what was sent, shape (m,).
        stated: What the machine states, shape (m,) [A].
        sent: What was sent, shape (m,) [A].
        bounds: Where they may be, with the drive limits as they are now.
        told: Puts that the server refused, by index.
        refusals: So far.
        now: Monotonic [s].
        settings: Thresholds.
    """
    edge = np.where(sent > bounds.high, bounds.high, bounds.low)
    beyond = (sent > bounds.high) | (sent < bounds.low)
    near = np.abs(stated - edge) <= 1e-3 * np.maximum(np.abs(edge), 1.0)
    clipped = other & bounds.drive & beyond & near
    before = np.full(len(sent), -np.inf) if refusals.missed is None else refusals.missed
    named = np.zeros_like(other)
    named[list(told)] = True
    unnamed = other & ~clipped & ~named
    few = int(np.count_nonzero(unnamed)) <= settings.max_lost_correctors
    again = unnamed & (now - before <= FORGIVEN) & few
    refused = (other & ~clipped & named) | again
    found = dict(refusals.found)
    for index in np.flatnonzero(refused).tolist():
        seen = f"reads {stated[index]:.4g} A after {sent[index]:.4g} A was sent"
        found[index] = f"{told[index]}, {seen}" if index in told else f"does not keep puts: {seen}"
    moved = unnamed & ~again
    if not few:
        moved &= np.abs(stated - sent) > (settings.readback_tolerance or 0.0)
        return Judged(moved, replace(refusals, found=found))
    missed = np.where(unnamed, now, before)
    return Judged(moved, replace(refusals, missed=missed, found=found))


def settled(refusals: Refusals, readback: Vector, setpoints: Vector) -> Refusals:
    """Remember how readbacks differ from setpoints that the machine has just stated.

    Args:
        refusals: So far.
        readback: Shape (m,) [A]; NaN where none is known.
        setpoints: As stated, shape (m,) [A].
    """
    return replace(refusals, offset=readback - setpoints, beyond=None)


def doubtful(
    readback: Vector,
    recent: tuple[Vector, ...],
    ours: Mask,
    refusals: Refusals,
    settings: InterlockSettings,
) -> tuple[bool, Refusals]:
    """Say whether readbacks tell of setpoints that are not what was sent, too little for a fault.

    Args:
        readback: Shape (m,) [A]; NaN where none is known.
        recent: Setpoints in force at this orbit and at the ones before, newest first [A].
        ours: Correctors that the loop moves, shape (m,).
        refusals: So far.
        settings: Thresholds.

    Returns:
        Whether to ask for the setpoints, and what to remember.
    """
    if refusals.offset is None or settings.readback_tolerance is None:
        return False, refusals
    low = high = recent[0]
    for earlier in recent[1 : settings.readback_lag + 1]:
        low, high = np.minimum(low, earlier), np.maximum(high, earlier)
    at, tolerance = readback - refusals.offset, tolerance_of(settings)
    off = ours & ((at < low - tolerance) | (at > high + tolerance))  # False where not known
    before = np.zeros(off.shape, dtype=np.int64) if refusals.beyond is None else refusals.beyond
    # One that is taken back every other tick is off at half of them.
    counts = np.maximum(before + np.where(off, 2, -1), 0)
    asks = bool((off & (counts >= 2 * (settings.readback_ticks + settings.readback_lag))).any())
    return asks, replace(refusals, beyond=counts)
