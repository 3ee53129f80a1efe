"""Which BPM and which corrector went wrong first."""

import tomllib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from orbitfb.core.robust import TO_SIGMA
from orbitfb.core.signals import Mask, Vector
from orbitfb.observe.wording import micrometres
from orbitfb.postmortem.reading import PostMortem
from orbitfb.safety.interlocks import InterlockSettings, not_following

OUTSIDE = 8.0
"""A reading is outside when it is that many deviations from where it usually was."""

_LEAST_DEVIATION = 1e-8
_LOOK_BACK = 10.0


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


def error_of(its: PostMortem) -> Vector:
    """Give orbit − reference, shape (rows, n) [m]; NaN where a BPM does not count."""
    columns = its.columns
    orbit = np.where(valid_of(its) & its.counting, columns["orbit"], np.nan)
    return orbit - columns["reference"]


def valid_of(its: PostMortem, rows: slice = slice(None)) -> Mask:
    """Say which readings were valid and finite, shape (rows, n)."""
    return its.columns["valid"][rows] & np.isfinite(its.columns["orbit"][rows])


def interlocks_of(its: PostMortem) -> InterlockSettings:
    """Give the thresholds of the run; the defaults where the configuration does not say."""
    try:
        table: Any = tomllib.loads(its.configuration).get("interlocks", {})
        return InterlockSettings.model_validate(table)
    except (tomllib.TOMLDecodeError, ValidationError, RecursionError):
        return InterlockSettings()


def first_bpm(
    its: PostMortem, error: Vector, usual: NDArray[np.intp], onset: int | None, trip: int
) -> Device | None:
    """Name the BPM that was lost, or that left first.

    Args:
        its: The post-mortem.
        error: Orbit error, shape (rows, n) [m]; NaN where a BPM does not count.
        usual: Rows that stand for how it was.
        onset: Row in which the orbit began to leave; None when it did not.
        trip: Row of the trip.
    """
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
    spread = np.maximum(TO_SIGMA * _median(np.abs(known - middle)), _LEAST_DEVIATION)
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


def first_corrector(its: PostMortem, trip: int) -> Device | None:
    """Name the corrector whose readback left its setpoint first, in the last seconds.

    Args:
        its: The post-mortem.
        trip: Row of the trip.
    """
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
