"""The records that Channel Access delivers, as numpy arrays (`dbr_time_double`, db_access.h)."""

import numpy as np
from numpy.typing import NDArray

EPICS_EPOCH = 631_152_000
"""1990-01-01 00:00 UTC [s since the epoch]: where EPICS stamps begin."""

NANOSECONDS = 1_000_000_000
INVALID = 3
"""Alarm severity of a value that must not be used."""

RECORD = np.dtype(
    {
        "names": ["status", "severity", "seconds", "nanoseconds", "value"],
        "formats": [np.int16, np.int16, np.uint32, np.uint32, np.float64],
        "offsets": [0, 2, 4, 8, 16],
        "itemsize": 24,
    }
)


def blank_records(size: int) -> NDArray[np.void]:
    """Return records as they are before anything has come: INVALID, NaN, stamp 0."""
    records = np.zeros(size, dtype=RECORD)
    records["severity"] = INVALID
    records["value"] = np.nan
    return records


def stamps_of(records: NDArray[np.void]) -> NDArray[np.int64]:
    """Return the stamps of records [ns since the EPICS epoch]."""
    return records["seconds"] * np.int64(NANOSECONDS) + records["nanoseconds"]


def wall_time(stamp: int) -> float:
    """Convert a stamp [ns since the EPICS epoch] to [s since the epoch]."""
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    return seconds + EPICS_EPOCH + nanoseconds / NANOSECONDS


def usable(records: NDArray[np.void]) -> NDArray[np.bool_]:
    """Tell which records hold a finite value that is not INVALID."""
    return (records["severity"] < INVALID) & np.isfinite(records["value"])
