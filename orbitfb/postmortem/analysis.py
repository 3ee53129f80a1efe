"""What went wrong first: figures of a post-mortem, as functions of its columns."""

import tomllib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from orbitfb.core.signals import Mask, Vector
from orbitfb.observe.wording import micrometres
from orbitfb.postmortem.reading import PostMortem
from orbitfb.safety.interlocks import InterlockSettings, not_following

CURRENT = "auxiliary/current"
"""Column of the stored current [A]."""

OUTSIDE = 8.0
"""A reading is outside when it is that many deviations from where it usually was."""

_RISE = 1.5
_LEAST_DEVIATION = 1e-8
_LOOK_BACK = 10.0


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
class Device:
    """A device that went wrong first.

    Args:
        name: Of the BPM or corrector.
        since_trip: When [s].
        what: In words.
        others: How many went wrong at the same tick besides.
    """

    name: str
    since_trip: float
    what: str
    others: int


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


def error_of(its: PostMortem) -> Vector:
    """Give orbit − reference, shape (rows, n) [m]; NaN where a BPM does not count."""
    columns = its.columns
    orbit = np.where(valid_of(its) & its.counting, columns["orbit"], np.nan)
    return orbit - columns["reference"]


def valid_of(its: PostMortem, rows: slice = slice(None)) -> Mask:
    """Say which readings were valid and finite, shape (rows, n)."""
    return its.columns["valid"][rows] & np.isfinite(its.columns["orbit"][rows])


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
        _first_bpm(its, error, usual, onset, trip),
        _first_corrector(its, trip),
    )


def interlocks_of(its: PostMortem) -> InterlockSettings:
    """Give the thresholds of the run; the defaults where the configuration does not say."""
    try:
        table: Any = tomllib.loads(its.configuration).get("interlocks", {})
        return InterlockSettings.model_validate(table)
    except (tomllib.TOMLDecodeError, ValidationError, RecursionError):
        return InterlockSettings()


def _onset(rms: Vector, trip: int) -> int | None:
    """Find the row from which the rms stayed above what was usual, up to the trip."""
    early = rms[: max(trip // 2, 1)]
    early = early[np.isfinite(early)]
    if not len(early) or not np.isfinite(rms[: trip + 1]).any():
        return None
    middle = float(np.median(early))
    spread = 1.4826 * float(np.median(np.abs(early - middle)))
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


def _first_bpm(
    its: PostMortem, error: Vector, usual: NDArray[np.intp], onset: int | None, trip: int
) -> Device | None:
    """Name the BPM that was lost, or that left first."""
    since, bpms = its.columns["since_trip"], its.channels.bpms
    lost = _lost(its, trip)
    if lost is not None and (onset is None or lost[0] <= onset):
        row, mask = lost
        where = int(np.flatnonzero(mask)[0])
        return Device(bpms[where], float(since[row]), "became invalid", int(mask.sum()) - 1)
    if onset is None:
        return None
    known = error[usual]
    middle = _median(known)
    spread = np.maximum(1.4826 * _median(np.abs(known - middle)), _LEAST_DEVIATION)
    spread = np.where(np.isfinite(spread), spread, _LEAST_DEVIATION)
    away = np.abs(error[onset] - np.nan_to_num(middle))
    score = np.nan_to_num(away / np.maximum(spread, np.median(spread)))
    where = int(np.argmax(score))
    outside = int((score > OUTSIDE).sum())
    what = f"{micrometres(away[where])} from where it was, {score[where]:.3g} of its usual spreads"
    if outside > np.isfinite(error[onset]).sum() / 2:
        what = f"the whole orbit left within this tick; this BPM was furthest out: {what}"
        outside = 0
    return Device(bpms[where], float(since[onset]), what, max(outside - 1, 0))


def _lost(its: PostMortem, trip: int) -> tuple[int, Mask] | None:
    """Find the first tick of the last seconds in which BPMs became invalid and stayed so."""
    valid, since = valid_of(its) | ~its.counting, its.columns["since_trip"]
    read = np.flatnonzero(np.isfinite(its.columns["time"][: trip + 1]))
    read = read[since[read] >= since[trip] - _LOOK_BACK]
    if not len(read):
        return None
    lost = valid[read[0]] & ~valid[read[-1]]
    for row in read:
        if (lost & ~valid[row]).any():
            return int(row), lost & ~valid[row]
    return None


def _first_corrector(its: PostMortem, trip: int) -> Device | None:
    """Name the corrector whose readback left its setpoint first, in the last seconds."""
    settings = interlocks_of(its)
    columns, since = its.columns, its.columns["since_trip"]
    begin = int(np.searchsorted(since, since[trip] - _LOOK_BACK))
    found: tuple[int, Mask] | None = None
    for row in range(trip, begin - 1, -1):
        known = np.isfinite(columns["time"][row]) and np.isfinite(columns["setpoints"][row]).all()
        if not known:
            continue
        recent = columns["setpoints"][max(row - settings.readback_lag, 0) : row + 1]
        off = not_following(columns["readback"][row], list(recent[::-1]), settings)
        if not off.any():
            break
        found = row, off
    if found is None:
        return None
    row, off = found
    where = int(np.flatnonzero(off)[0])
    away = columns["readback"][row, where] - columns["setpoints"][row, where]
    what = (
        f"its readback was {away:+.3g} A from its setpoint"
        if np.isfinite(away)
        else "its readback was not known"
    )
    return Device(its.channels.correctors[where], float(since[row]), what, int(off.sum()) - 1)


def _median(values: Vector) -> Vector:
    """Give the median of every column over what is known; NaN where nothing is."""
    known = np.isfinite(values).any(axis=0) if len(values) else np.zeros(values.shape[1], bool)
    middle = np.full(values.shape[1], np.nan)
    if known.any():
        middle[known] = np.nanmedian(values[:, known], axis=0)
    return middle
