"""Our record layouts are those of db_access.h, as pyepics states them."""

import ctypes

import numpy as np
import pytest
from epics import dbr

from orbitfb.epics.records import (
    EPICS_EPOCH,
    NANOSECONDS,
    RECORD,
    blank_records,
    stamps_of,
    usable,
    wall_time,
)
from orbitfb.epics.requests import CONTROL_RECORD


def test_monitor_record_is_dbr_time_double():
    raw = dbr.time_double(status=17, severity=2, value=1.25)
    raw.stamp.secs, raw.stamp.nsec = 4_000_000_000, 999_999_999
    record = np.frombuffer(bytes(raw), dtype=RECORD)
    assert RECORD.itemsize == ctypes.sizeof(dbr.time_double)
    assert record[0].item() == (17, 2, 4_000_000_000, 999_999_999, 1.25)


def test_control_record_is_dbr_ctrl_double():
    raw = dbr.ctrl_double(upper_ctrl_limit=18.0, lower_ctrl_limit=-17.0, value=0.5)
    raw.units = b"A"
    record = np.frombuffer(bytes(raw), dtype=CONTROL_RECORD)
    assert CONTROL_RECORD.itemsize == ctypes.sizeof(dbr.ctrl_double)
    assert record[0].item() == (b"A", 18.0, -17.0, 0.5)


def test_stamps_are_exact_to_the_nanosecond():
    records = blank_records(2)
    records["seconds"], records["nanoseconds"] = 4_294_967_295, [0, 999_999_999]
    first, second = stamps_of(records).tolist()
    assert first == 4_294_967_295 * NANOSECONDS
    assert second - first == 999_999_999


def test_wall_time_counts_from_1970():
    assert EPICS_EPOCH == dbr.EPICS2UNIX_EPOCH
    assert wall_time(NANOSECONDS * 3 // 2) == pytest.approx(EPICS_EPOCH + 1.5, abs=1e-6)


def test_nothing_is_usable_before_anything_came():
    assert not usable(blank_records(3)).any()
