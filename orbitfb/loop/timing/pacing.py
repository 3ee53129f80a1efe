"""Which orbits become ticks, and how many never came: pure functions of stamps."""

import math
from dataclasses import dataclass

from orbitfb.core.values import replace

_SMOOTHING = 0.1
_UNKNOWN = float("nan")
SLOWER = 1.5
"""Intervals of so many periods are another rate: one lost orbit in two ticks makes no more."""


@dataclass(frozen=True, slots=True)
class Pace:
    """Where the loop stands in the stream of orbits.

    Args:
        acted: Stamp of the orbit of the last tick [s since the epoch].
        due: Stamp that the next tick waits for [s since the epoch].
        seen: Stamp of the last orbit, a tick's or one passed over [s since the epoch].
        interval: Smoothed time between two orbits [s].
        received: When the orbit of the last tick was complete, monotonic [s].
        counted: Orbits that were reported as missed since then.
    """

    acted: float = _UNKNOWN
    due: float = _UNKNOWN
    seen: float = _UNKNOWN
    interval: float = _UNKNOWN
    received: float = _UNKNOWN
    counted: int = 0


def see(stamp: float, pace: Pace, period: float) -> tuple[bool, Pace]:
    """Look at the stamp of a new orbit: is it the one for the next tick?

    A machine faster than the loop has every k-th orbit taken; the time between its orbits is
    measured, and half of it is the tolerance, so that a machine at the rate of the loop never
    has one passed over because of jitter.

    Args:
        stamp: Of the orbit [s since the epoch].
        pace: So far.
        period: Of the loop [s].
    """
    gap = stamp - pace.seen
    # Until it is measured, take it for a machine at the rate of the loop.
    interval = period if math.isnan(pace.interval) else pace.interval
    if gap > 0:
        interval += _SMOOTHING * (min(gap, 2.0 * interval) - interval)
    tolerance = min(interval, period) / 2
    # Not newer than the last tick: the clock of the machine stepped back, start afresh.
    is_due = not stamp > pace.acted or stamp >= pace.due - tolerance
    seen = Pace(pace.acted, pace.due, stamp, interval, pace.received, pace.counted)
    return is_due, seen


def slower(pace: Pace, period: float) -> str:
    """Say that orbits come less often than the loop ticks; empty when they do not.

    Args:
        pace: So far.
        period: Of the loop [s].
    """
    if not pace.interval >= SLOWER * period:
        return ""
    return f"orbits come at {1 / pace.interval:.2g} Hz, loop.rate_hz is {1 / period:.4g}"


def take(stamp: float, received: float, pace: Pace, period: float) -> tuple[int, Pace]:
    """Make an orbit a tick.

    Args:
        stamp: Of the orbit [s since the epoch].
        received: When it was complete, monotonic [s].
        pace: So far.
        period: Of the loop [s].

    Returns:
        How many orbits were missed and not reported yet, and the new pace.
    """
    missed = 0
    due = stamp + period
    gap = stamp - pace.acted
    if gap > 0:
        # A step of the machine's clock is not a heap of missed orbits: believe the shorter.
        waited = max(received - pace.received, 0.0)
        by_stamp, by_wait = round(gap / period) - 1, math.ceil(waited / period)
        missed = max(0, min(by_stamp, by_wait) - pace.counted)
        # Keep the grid through jitter, but follow a machine that runs early or late.
        due = min(max(pace.due + period, stamp + period / 2), stamp + period)
    return missed, Pace(stamp, due, pace.seen, pace.interval, received, 0)


def miss(now: float, pace: Pace, period: float) -> tuple[int, Pace]:
    """Count what should have come by now and did not.

    Args:
        now: Monotonic [s].
        pace: So far.
        period: Of the loop [s].

    Returns:
        How many orbits were missed and not reported yet, and the new pace.
    """
    if math.isnan(pace.received):
        return 0, pace
    total = math.floor((now - pace.received) / period + 1e-6)
    missed = max(0, total - pace.counted)
    return missed, replace(pace, counted=pace.counted + missed)
