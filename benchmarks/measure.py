"""Clocks of processes, and figures out of samples."""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Samples = NDArray[np.float64]


def cpu_time(pid: int) -> float:
    """CPU time that a process has used [s], to the nanosecond (Linux)."""
    return time.clock_gettime((~pid << 3) | 2)


def spread(seconds: Samples | Sequence[float]) -> dict[str, Any] | None:
    """Sum up durations: percentiles in ms, and all percents from 0 to 100 in µs."""
    figures = brief(seconds)
    if figures is not None:
        samples = np.asarray(seconds, dtype=np.float64)
        percents = np.percentile(samples[np.isfinite(samples)], np.arange(101))
        figures["percents_us"] = [round(value * 1e6) for value in percents.tolist()]
    return figures


def brief(seconds: Samples | Sequence[float]) -> dict[str, Any] | None:
    """Sum up durations in a few percentiles [ms]."""
    samples = np.asarray(seconds, dtype=np.float64)
    samples = samples[np.isfinite(samples)]
    if not samples.size:
        return None
    percentiles = {
        f"p{k}": round(float(np.percentile(samples, k)) * 1e3, 4) for k in (1, 50, 90, 99)
    }
    return {
        "count": int(samples.size),
        **percentiles,
        "max": round(float(samples.max()) * 1e3, 4),
    }


def first_after(events: Samples, moments: Samples) -> Samples:
    """For every moment give the first event at or after it; NaN where there is none."""
    events = np.sort(events[np.isfinite(events)])
    at = np.searchsorted(events, moments)
    found = np.full(moments.shape, np.nan)
    inside = at < events.size
    found[inside] = events[at[inside]]
    return found


def window_figures(
    *,
    period: float | None,
    stamps: Samples,
    put_from: Samples,
    put_until: Samples,
    applied: Samples,
    torn: int,
    server_cpu: float,
    client_cpu: float,
) -> dict[str, Any]:
    """Sum up one run; arrays have one element per tick, wall clock [s].

    Args:
        period: Of the ring [s]; None: lockstep.
        stamps: When the server began to publish the orbit.
        put_from: When the first setpoint was put; NaN where none was.
        put_until: When the last one had left.
        applied: When the server applied a last setpoint, in any order.
        torn: Orbits that were not of one tick.
        server_cpu: CPU time of the server [s].
        client_cpu: CPU time of the client [s].
    """
    ticks = stamps.size
    seconds = float(stamps[-1] - stamps[0])
    if period is None:
        round_trip = np.diff(stamps)
        missed = None
    else:
        round_trip = first_after(applied, put_from) - stamps
        missed = round(seconds / period) + 1 - int(np.count_nonzero(np.isfinite(put_until)))
    return {
        "ticks": ticks,
        "seconds": round(seconds, 3),
        "measured_rate_hz": round((ticks - 1) / seconds, 2),
        "missed": missed,
        "torn": torn,
        "round_trip_ms": spread(round_trip),
        "latency_ms": spread(put_until - stamps),
        "orbit_interval_ms": brief(np.diff(stamps)),
        "write_interval_ms": brief(np.diff(put_until)),
        "server_cpu_ms": round(server_cpu / ticks * 1e3, 4),
        "client_cpu_ms": round(client_cpu / ticks * 1e3, 4),
    }
