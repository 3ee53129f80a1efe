"""What is taken of a PV over pvAccess: values, alarm, stamp, unit, limits, where it has them."""

import numpy as np
import pytest

from orbitfb.epics.libca import DBR_DOUBLE
from orbitfb.epics.pva.held import Held
from orbitfb.epics.records import EPICS_EPOCH
from orbitfb.epics.stated.contents import INTEGER, STRUCTURE, TEXT


class Told(dict):
    """As much of a value of p4p as is looked at; all of it has changed."""

    def has(self, name):
        return name in self

    def changed(self, *names):
        return any(key.partition(".")[0] in names for key in self)


FULL = {
    "value": np.array([1.0, 2.0]),
    "alarm.severity": 1,
    "alarm.status": 3,
    "timeStamp.secondsPastEpoch": EPICS_EPOCH + 100,
    "timeStamp.nanoseconds": 7,
    "display.units": "mm",
    "control.limitLow": -1.0,
    "control.limitHigh": 1.0,
}


def held(**changes):
    its = Held()
    its.take(Told({**FULL, **{key.replace("__", "."): its for key, its in changes.items()}}))
    return its


def test_all_of_it_is_taken():
    its = held()
    assert its.values.tolist() == [1.0, 2.0] and its.kind == DBR_DOUBLE
    assert its.head == (3, 1, 100, 7)
    assert (its.units, its.limits) == ("mm", (-1.0, 1.0))


@pytest.mark.parametrize(
    ("value", "kind", "count"),
    [
        (np.array([1, 2, 3], dtype=np.int32), INTEGER, 3),
        (["a", "b"], TEXT, 2),
        ("text", TEXT, 1),
        (3.5, DBR_DOUBLE, 1),
        (np.zeros(0), DBR_DOUBLE, 0),
        ({"index": 1}, STRUCTURE, 0),
        (None, STRUCTURE, 0),
    ],
)
def test_what_is_no_array_of_numbers_is_known(value, kind, count):
    its = held(value=value)
    assert (its.kind, len(its.values)) == (kind, count)
    assert kind in (INTEGER, DBR_DOUBLE) or np.isnan(its.values).all()


@pytest.mark.parametrize(
    ("seconds", "nanoseconds"),
    [
        (0, 0),
        (-5, 0),
        (EPICS_EPOCH, 0),
        (2**40, 0),
        (EPICS_EPOCH + 5, -1),
        (EPICS_EPOCH + 5, 10**9),
    ],
)
def test_a_stamp_that_is_absent_or_wrong_is_none(seconds, nanoseconds):
    its = held(timeStamp__secondsPastEpoch=seconds, timeStamp__nanoseconds=nanoseconds)
    assert its.head[2:] == (0, 0)


def test_a_structure_without_alarm_stamp_and_limits_has_none():
    its = Held()
    assert not its.take(Told(value=np.array([1.0])))
    assert its.head == (0, 0, 0, 0) and its.units == "" and np.isnan(its.limits).all()


@pytest.mark.parametrize(
    "change", [{"display.units": "um"}, {"control.limitHigh": 0.5}, {"control.limitHigh": -1.0}]
)
def test_another_unit_or_limit_is_told_once(change):
    its = held()
    assert not its.take(Told(FULL))
    assert its.take(Told({**FULL, **change}))
    assert not its.take(Told({**FULL, **change}))
