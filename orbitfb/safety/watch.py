"""Interlocks that look at several ticks: memory in, verdict and new memory out."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Mask, Orbit, Vector
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.verdict import FINE, Action, Verdict, name_some

RISING = 1.0
"""Time over which a growth of the rms is looked at [s]."""


@dataclass(frozen=True, slots=True)
class Growth:
    """A stretch of ticks over which the rms grew.

    Args:
        start: Rms at which it began [m].
        last: Rms of the last tick [m].
        ticks: Ticks in a row that grew.
    """

    start: float = float("inf")
    last: float = float("inf")
    ticks: int = 0


def divergence(rms: float, memory: Growth, settings: InterlockSettings) -> tuple[Verdict, Growth]:
    """Trip when the rms grows tick by tick, by a factor, to above the noise.

    In the noise every other tick grows by a little: there one counts that grows by its share of the
    factor, so that a single kick after a few of those is no divergence.

    Args:
        rms: Of the orbit error [m].
        memory: What the last call returned.
        settings: Thresholds.
    """
    noisy = memory.last <= settings.divergence_floor
    share = settings.divergence_factor ** (1.0 / settings.divergence_ticks) if noisy else 1.0
    if rms <= share * memory.last:
        return FINE, Growth(rms, rms, 0)
    grown = Growth(memory.start, rms, memory.ticks + 1)
    if grown.ticks < settings.divergence_ticks:
        return FINE, grown
    if rms <= settings.divergence_floor or rms < settings.divergence_factor * grown.start:
        return FINE, grown
    reason = (
        f"the orbit error grew for {grown.ticks} ticks in a row, "
        f"from {grown.start * 1e6:.3g} to {rms * 1e6:.3g} µm rms"
    )
    return Verdict(Action.TRIP, "divergence", reason), grown


@dataclass(frozen=True, slots=True)
class Rise:
    """How the rms has been.

    Args:
        base: What it was about a second ago, or less since [m]; NaN: not known.
        time: Of the last orbit, monotonic [s].
    """

    base: float = float("nan")
    time: float = float("nan")


def rising(
    rms: float, time: float, memory: Rise, settings: InterlockSettings
) -> tuple[Verdict, Rise]:
    """Trip when the rms grows too fast.

    The base follows the rms with a time constant of a second, downwards at once: behind a steady
    growth it stays by what the rms grows in a second, a sudden step counts as a whole.

    Args:
        rms: Of the orbit error [m].
        time: When the orbit was complete, monotonic [s].
        memory: What the last call returned.
        settings: Thresholds.
    """
    base = memory.base
    if not rms > base:  # also the first
        return FINE, Rise(rms, time)
    base += (rms - base) * -math.expm1(-max(time - memory.time, 0.0) / RISING)
    most, rate = settings.distortion_rate, (rms - base) / RISING
    if most is None or rate <= most:
        return FINE, Rise(base, time)
    reason = (
        f"the rms orbit error grows by {rate * 1e6:.4g} µm/s to {rms * 1e6:.4g} µm; "
        f"allowed: {most * 1e6:.4g} µm/s"
    )
    return Verdict(Action.TRIP, "distortion_rate", reason), Rise(base, time)


@dataclass(frozen=True, slots=True)
class LastOrbit:
    """The orbit before this one.

    Args:
        position: Shape (n,) [m]; None before the first.
        time: Stamp [s since the epoch].
        repeats: Ticks in a row that brought the same readings again.
    """

    position: Vector | None = None
    time: float = float("-inf")
    repeats: int = 0


def repeated(
    orbit: Orbit, valid: Mask, memory: LastOrbit, settings: InterlockSettings
) -> tuple[Verdict, LastOrbit]:
    """Refuse an orbit that is not newer than the last, or has the very same readings.

    After a clock that stepped back one orbit is lost, not all until the old time is reached.

    Args:
        orbit: As read.
        valid: BPMs that count, shape (n,).
        memory: What the last call returned.
        settings: Thresholds.
    """
    same = memory.position is not None and bool(
        np.array_equal(orbit.position[valid], memory.position[valid])
    )
    repeats = memory.repeats + 1 if same else 0
    now = LastOrbit(orbit.position, orbit.time, repeats)
    if not orbit.time > memory.time:
        reason = f"the stamp {orbit.time:.6f} is not newer than that of the orbit before"
        return Verdict(Action.SKIP, "repeated", reason), now
    if settings.frozen_ticks and repeats >= settings.frozen_ticks:
        reason = f"all {int(np.count_nonzero(valid))} readings are those of the orbit before"
        return Verdict(Action.SKIP, "frozen", reason), now
    return FINE, now


def readback(
    missing: Mask,
    counts: NDArray[np.int64],
    ticks: int,
    names: Sequence[str] = (),
) -> tuple[Verdict, NDArray[np.int64]]:
    """Hold when a corrector does not follow its setpoint for some ticks in a row.

    Args:
        missing: Correctors that do not follow now, shape (m,), from `not_following`.
        counts: Ticks in a row so far, shape (m,).
        ticks: How many hold the loop.
        names: The correctors, for the reason.
    """
    if not missing.any():
        return FINE, np.zeros_like(counts) if counts.any() else counts
    counts = np.where(missing, counts + 1, 0)
    held = counts >= ticks
    if held.any():
        reason = f"{int(held.sum())} correctors do not follow their setpoint: "
        return Verdict(Action.HOLD, "readback", reason + name_some(held, names)), counts
    reason = f"{int(missing.sum())} readbacks are off their setpoint: {name_some(missing, names)}"
    return Verdict(Action.WARN, "readback", reason), counts
