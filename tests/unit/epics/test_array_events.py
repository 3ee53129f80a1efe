"""Events of arrays: one stamp for all elements, and what an array does not have is NaN."""

import numpy as np
import pytest

from orbitfb.core.names import named_pvs
from orbitfb.epics.events import BEFORE_VALUES, Monitor, array_handler
from orbitfb.epics.libca import ECA_NORMAL, EventArguments
from orbitfb.epics.orbit.assembler import Assembler
from orbitfb.epics.records import stamps_of
from orbitfb.epics.setpoints.put_watch import PutWatch

NAMES = ("X.[1]", "X.[0]", "Y.[0]", "Y.[1]")


def event(handler, number, values, stamp=5, severity=0, status=ECA_NORMAL):
    head = np.zeros(1, dtype=BEFORE_VALUES)
    head["seconds"], head["severity"] = stamp, severity
    data = np.frombuffer(head.tobytes() + np.array(values, dtype=float).tobytes() + b" ", np.uint8)
    told = {"user": number, "count": len(values), "data": data.ctypes.data, "status": status}
    handler(EventArguments(**told))


class Two:
    """An orbit in two arrays."""

    def __init__(self):
        self.assembler, self.orbits = Assembler(4), []
        self.lengths = np.full(2, -1)
        monitor = Monitor(self.assembler.records, self.assembler.arrived, self.complete)
        self.handler = array_handler(monitor, named_pvs(NAMES), self.lengths)
        for place in range(4):
            self.assembler.set_connected(place, True)

    def complete(self):
        self.orbits.append(self.assembler.snapshot())


@pytest.fixture
def two():
    return Two()


def test_an_orbit_is_complete_with_the_last_array_and_in_the_order_of_the_names(two):
    event(two.handler, 1, [10.0, 11.0])
    assert not two.orbits
    event(two.handler, 2, [20.0, 21.0])
    [orbit] = two.orbits
    assert orbit.values.tolist() == [11.0, 10.0, 20.0, 21.0]
    assert orbit.valid.all()
    event(two.handler, 2, [20.0, 22.0], stamp=6)
    event(two.handler, 1, [10.0, 12.0], stamp=7)
    assert len(two.orbits) == 1  # of two ticks: torn
    event(two.handler, 2, [20.0, 23.0], stamp=7)
    assert two.orbits[1].values.tolist() == [12.0, 10.0, 20.0, 23.0]


def test_what_an_array_does_not_have_is_not_valid(two):
    event(two.handler, 1, [10.0, 11.0])
    event(two.handler, 2, [20.0])
    event(two.handler, 1, [np.nan, 11.0], stamp=6)
    event(two.handler, 2, [], stamp=6)
    assert [orbit.valid.tolist() for orbit in two.orbits] == [
        [True, True, True, False],
        [True, False, False, False],
    ]
    assert two.lengths.tolist() == [2, 0]


def test_an_alarm_is_that_of_all_elements_and_a_bad_event_is_none(two):
    event(two.handler, 1, [10.0, 11.0], severity=3)
    event(two.handler, 2, [20.0, 21.0], status=0)
    assert not two.orbits
    event(two.handler, 2, [20.0, 21.0])
    assert two.orbits[0].valid.tolist() == [False, False, True, True]
    assert (stamps_of(two.assembler.records) == 5_000_000_000).all()


def test_only_elements_that_changed_were_put():
    watch = PutWatch(4)
    handler = array_handler(
        Monitor(watch.records, heard=watch.heard), named_pvs(NAMES), np.full(2, -1)
    )
    for number in (1, 2):
        event(handler, number, [0.0, 0.0])
    assert watch.take() is None  # that is where they are
    watch.sends(np.array([0.1, 0.2, np.nan, np.nan]), np.array([True, True, False, False]))
    event(handler, 1, [0.2, 0.1])
    event(handler, 2, [0.0, 0.0])
    assert watch.take() is None
    event(handler, 1, [0.2, 0.7])
    assert watch.take().tolist() == [True, False, False, False]
