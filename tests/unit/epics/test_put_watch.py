"""Whose put it was: what was not sent from here was put by somebody else."""

import numpy as np
import pytest
from fake_libca import Bench

from orbitfb.epics.libca import ECA_NORMAL, EventArguments
from orbitfb.epics.setpoints.put_watch import EVENTS, SENDS, PutWatch

ALL = np.ones(3, dtype=bool)


class Heard:
    """A watch whose channels have come and told where they are."""

    def __init__(self):
        self.watch = PutWatch(3)
        for index in range(3):
            self.event(index, 0.0)

    def event(self, index, value):
        self.watch.records["value"][index] = value
        self.watch.heard(index)

    def put(self, values, which=ALL):
        self.watch.sends(np.array(values), which)

    def taken(self):
        mask = self.watch.take()
        return [] if mask is None else np.flatnonzero(mask).tolist()


@pytest.fixture
def heard():
    return Heard()


def test_what_was_sent_is_ours_also_if_its_answer_comes_late(heard):
    for tick in range(5):
        heard.put([tick, 0.1 * tick, -tick])
    for tick in range(5):
        for index, value in enumerate([tick, 0.1 * tick, -tick]):
            heard.event(index, value)
    assert heard.taken() == []


def test_what_was_not_sent_was_put_by_somebody_else_once(heard):
    heard.put([1.0, 2.0, 3.0])
    for index, value in enumerate([1.0, 2.0, 3.0]):
        heard.event(index, value)
    heard.event(1, 2.0001)
    assert heard.taken() == [1]
    assert heard.taken() == []


def test_a_put_that_was_overwritten_within_the_tick_is_seen_too(heard):
    heard.put([1.0, 2.0, 3.0])
    heard.event(0, 0.9)
    heard.event(0, 1.0)
    assert heard.taken() == [0]


def test_where_a_channel_is_when_it_comes_was_put_by_nobody(heard):
    heard.put([1.0, 2.0, 3.0])
    heard.watch.came(2)
    heard.event(2, 0.7)
    assert heard.taken() == []
    heard.event(2, 0.8)
    assert heard.taken() == []  # it has not shown what was sent yet: perhaps it rounds
    heard.event(2, 3.0)
    heard.event(2, 0.8)
    assert heard.taken() == [2]


def test_a_record_that_rounds_tells_nothing_while_it_is_put_to(heard):
    for value in (0.1234, 0.2345, 0.3456):
        heard.put([value, value, value], np.array([True, False, True]))
        heard.event(0, round(value, 1))
        heard.event(2, value)
    assert heard.taken() == []
    heard.event(1, 0.5)  # nothing was put to this one
    assert heard.taken() == [1]


def test_no_number_is_nobodys_put_and_old_sends_are_forgotten(heard):
    heard.put([1.0, 1.0, 1.0])
    heard.event(0, 1.0)
    heard.event(0, np.nan)
    assert heard.taken() == []
    for tick in range(SENDS):
        heard.put([2.0 + tick] * 3)
    heard.event(0, 1.0)
    assert heard.taken() == [0]


def test_what_nobody_takes_is_bounded(heard):
    for _ in range(10 * EVENTS):
        heard.event(0, 0.5)
    assert len(heard.watch._heard) == 3 * EVENTS


def test_the_machine_hears_its_setpoints(monkeypatch):
    bench = Bench(monkeypatch)
    group, watch = bench.setpoints, bench.machine._setpoints.watch

    def event(index, value):
        record = np.zeros(1, dtype=watch.records.dtype)
        record["value"] = value
        begin = watch.records.ctypes.data + index * record.itemsize
        arguments = EventArguments(user=begin, status=ECA_NORMAL, data=record.ctypes.data)
        group._scalar_handler(arguments)

    for index in range(3):
        event(index, 0.0)
    bench.machine.write(np.array([0.1, 0.2, 0.3]))
    for index, value in enumerate([0.1, 0.2, 0.3]):
        event(index, value)
    assert watch.take() is None
    event(2, 0.31)
    assert watch.take().tolist() == [False, False, True]
    bench.link(2, up=False)
    bench.link(2, up=True)
    event(2, 5.0)
    assert watch.take() is None
