"""Figures of a post-mortem, as functions of its columns."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.robust import TO_SIGMA
from orbitfb.core.signals import Vector
from orbitfb.postmortem.devices import OUTSIDE, Device, error_of, first_bpm, first_corrector
from orbitfb.postmortem.reading import PostMortem

CURRENT = "auxiliary/current"
"""Column of the stored current [A]."""

_RISE = 1.5


@dataclass(frozen=True, slots=True)
class Sizes:
    """A figure before, at and after the trip; NaN where unknown.

    Args:
        before: Median of the usual time.
        at: Of the last tick up to the trip that knows it.
        after: Of the last tick that is kept.
    """

    before: float
    at: float
    after: float


@dataclass(frozen=True, slots=True)
class Analysis:
    """Figures of a post-mortem.

    Args:
        trip: Row of the trip; the last row up to it if that tick is not among them.
        usual: Rows before anything was unusual.
        onset: Row in which the orbit began to leave; None when it had not left at the trip.
        rms: Of the orbit error over the valid BPMs, every row [m]; NaN without an orbit.
        largest: Largest |orbit error| of every row [m].
        orbit: Its rms around the trip [m].
        peak: Largest |orbit error| at the trip [m].
        peak_bpm: Where that was; empty when unknown.
        current: Stored current around the trip [A].
        bpm: BPM that went wrong first.
        corrector: Corrector that went wrong first.
    """

    trip: int
    usual: NDArray[np.intp]
    onset: int | None
    rms: Vector
    largest: Vector
    orbit: Sizes
    peak: float
    peak_bpm: str
    current: Sizes
    bpm: Device | None
    corrector: Device | None


def analyse(its: PostMortem) -> Analysis | None:
    """Find out what went wrong first; None when no tick is kept."""
    if its.rows == 0:
        return None
    since = its.columns["since_trip"]
    trip = max(int(np.searchsorted(since, 1e-9, side="right")) - 1, 0)
    error = error_of(its)
    counts = np.isfinite(error).sum(axis=1)
    known = counts > 0
    rms, largest = (np.full(its.rows, np.nan) for _ in range(2))
    rms[known] = np.sqrt(np.nansum(error[known] ** 2, axis=1) / counts[known])
    largest[known] = np.nanmax(np.abs(error[known]), axis=1)
    onset = _onset(rms, trip)
    usual = _usual(its, trip if onset is None else onset)
    seen = np.flatnonzero(known[: trip + 1])
    peak, peak_bpm = float("nan"), ""
    if len(seen):
        at = int(np.nanargmax(np.abs(error[seen[-1]])))
        peak, peak_bpm = abs(float(error[seen[-1], at])), its.channels.bpms[at]
    current = its.columns.get(CURRENT, np.full(its.rows, np.nan))
    return Analysis(
        trip,
        usual,
        onset,
        rms,
        largest,
        _sizes(rms, usual, trip),
        peak,
        peak_bpm,
        _sizes(current, usual, trip),
        first_bpm(its, error, usual, onset, trip),
        first_corrector(its, trip),
    )


def _onset(rms: Vector, trip: int) -> int | None:
    """Find the row from which the rms stayed above what was usual, up to the trip."""
    early = rms[: max(trip // 2, 1)]
    early = early[np.isfinite(early)]
    if not len(early) or not np.isfinite(rms[: trip + 1]).any():
        return None
    middle = float(np.median(early))
    spread = TO_SIGMA * float(np.median(np.abs(early - middle)))
    limit = max(middle + OUTSIDE * spread, _RISE * middle)
    high = ~(rms[: trip + 1] <= limit)  # a tick without an orbit ends no stretch
    if not high[-1]:
        return None
    quiet = np.flatnonzero(~high)
    onset = int(quiet[-1]) + 1 if len(quiet) else 0
    found = np.flatnonzero(np.isfinite(rms[onset : trip + 1]))
    return onset + int(found[0]) if len(found) else None


def _usual(its: PostMortem, end: int) -> NDArray[np.intp]:
    """Choose the rows that stand for how it was: well before the end, in the state of then."""
    state, since = its.columns["state"], its.columns["since_trip"]
    rows = np.arange(end)
    same = rows[state[:end] == state[max(end - 1, 0)]]
    calm = same[since[same] < since[end] - 2.0]
    return calm[-300:] if len(calm) >= 5 else same if len(same) else rows


def _sizes(values: Vector, usual: NDArray[np.intp], trip: int) -> Sizes:
    def last(part: Vector) -> float:
        known = part[np.isfinite(part)]
        return float(known[-1]) if len(known) else float("nan")

    before = values[usual][np.isfinite(values[usual])]
    return Sizes(
        float(np.median(before)) if len(before) else float("nan"),
        last(values[: trip + 1]),
        last(values[trip + 1 :]),
    )
