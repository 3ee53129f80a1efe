"""The BPM and the corrector that stand out in one tick."""

import math

import numpy as np

from orbitfb.core.signals import Channels, TickRecord, Vector
from orbitfb.observe.statistics.averages import worst
from orbitfb.observe.statistics.snapshot import CorrectorFigures


def largest_error(last: TickRecord | None, channels: Channels) -> tuple[float, str]:
    """Return the largest |orbit − reference| of a tick [m] and its BPM; NaN when unknown.

    Args:
        last: The tick.
        channels: Names behind the vectors.
    """
    if last is None or last.reading is None or not last.reading.orbit.valid.any():
        return math.nan, ""
    orbit = last.reading.orbit
    error = np.where(orbit.valid, np.abs(orbit.position - last.reference), -1.0)
    where = int(np.argmax(error))
    return float(error[where]), channels.bpms[where]


def nearest_limit(last: TickRecord | None, channels: Channels, limits: Vector) -> CorrectorFigures:
    """Find the correctors nearest their limits, once the last change is in.

    Args:
        last: The last tick.
        channels: Names behind the vectors.
        limits: Limit of every |setpoint|, shape (m,) [A].
    """
    if last is None or not channels.correctors:
        return CorrectorFigures("", math.nan, float(limits.min()) if limits.size else math.nan, 0)
    setpoints = last.setpoints + last.applied
    parts = np.abs(setpoints) / limits
    where = int(np.argmax(parts))
    return CorrectorFigures(
        channels.correctors[where],
        float(setpoints[where]),
        float(limits[where]),
        0,
        worst(parts, channels.correctors, channels.corrector_planes),
    )
