"""A record of another time that is looked at together with the one in question."""

from pathlib import Path

import numpy as np

from orbitfb.core.errors import RecordError
from orbitfb.diagnose.screen.run import screen
from orbitfb.physics.places import Planes, Ring
from orbitfb.records.layout import Devices
from orbitfb.records.reading.load import load
from orbitfb.records.record import Record

_SAME_PERIOD = 0.1
"""Share by which the periods of two records may differ: what moves per tick goes with it."""

_SAME_MODEL = 1e-3
"""Difference of two models that comes of the type they are saved in, of their largest value [1]."""

_MOST_SHARED = 0.5
"""Share of its rows that a record may have in common with another one of few bits [1]."""


def read_beside(record: Record, path: Path, planes: Planes | None, ring: Ring | None) -> Record:
    """Read a record that is to be looked at together with the one in question.

    Raises:
        RecordError: It cannot be read; or it is of other devices, of another rate or model, the
            same data, or not intact.
    """
    loaded = load(path, planes=planes, ring=ring)
    other, own = loaded.record.layout, record.layout
    for array, its, wanted in (
        ("bpm_names", other.bpms, own.bpms),
        ("corr_names", other.correctors, own.correctors),
    ):
        if its != wanted:
            raise RecordError(
                f"{path}: array '{array}' differs from {record.source}: "
                f"{_first_difference(its, wanted)}; give a record of the same devices in the "
                "same order"
            )
    if abs(other.period - own.period) > _SAME_PERIOD * own.period:
        raise RecordError(
            f"{path}: array 't' says that orbits are {other.period:g} s apart, in {record.source} "
            f"they are {own.period:g} s apart; give a record of the same rate"
        )
    error, largest = np.abs(other.response - own.response).max(), np.abs(own.response).max()
    if error > _SAME_MODEL * largest:
        raise RecordError(
            f"{path}: array 'model_R' differs from {record.source} by up to "
            f"{error * 1e3:.3g} mm/A (largest element {largest * 1e3:.3g} mm/A); give both "
            "records the model that you want to test"
        )
    if _shared(record, loaded.record) > _MOST_SHARED:
        raise RecordError(
            f"{path}: array 'orbit' has the same rows as {record.source}, and the same data "
            "add nothing; give a record of another time, or leave the option out"
        )
    for finding in (*loaded.findings, *screen(loaded.record)):
        if finding.severity == "failure":
            raise RecordError(f"{path}: not intact: {finding.text}")
    return loaded.record


def _shared(first: Record, second: Record) -> float:
    """Share of the rows of the shorter record that are, to the last bit, in the other one."""
    rows = [
        {row.tobytes() for row in np.hstack([its.readings, its.setpoints])}
        for its in (first, second)
    ]
    return len(rows[0] & rows[1]) / min(map(len, rows))


def _first_difference(its: Devices, wanted: Devices) -> str:
    if len(its) != len(wanted):
        return f"it names {len(its)} devices instead of {len(wanted)}"
    for column in range(len(its)):
        if its.label(column) != wanted.label(column):
            return f"column {column} is {its.label(column)} instead of {wanted.label(column)}"
    return "the devices are in other cells"
