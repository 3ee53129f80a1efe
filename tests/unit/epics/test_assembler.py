"""No order, loss, repetition or interleaving of events makes a torn or repeated orbit."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orbitfb.epics.orbit.assembler import Assembler
from orbitfb.epics.records import INVALID, NANOSECONDS, usable

SIZE = 5
NAMES = tuple(f"BPM:{index}" for index in range(SIZE))
START = 1_000 * NANOSECONDS
PERIOD = 2_000_000  # shorter than some windows: neighbouring ticks may be coherent


def send(assembler: Assembler, index: int, stamp: int, value: float = 0.0, severity: int = 0):
    """Do what a monitor does; returns the snapshot when there is one."""
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    assembler.records[index] = (0, severity, seconds, nanoseconds, value)
    return assembler.snapshot() if assembler.arrived() else None


def connected(size: int = SIZE, window: float = 0.0) -> Assembler:
    assembler = Assembler(size, window)
    for index in range(size):
        assembler.set_connected(index, True)
    return assembler


def stamp_of(tick: int) -> int:
    return START + tick * PERIOD


@dataclass
class Model:
    """The same rule, looked at after every event, one channel at a time."""

    size: int
    window: int

    def __post_init__(self) -> None:
        self.stamp = dict.fromkeys(range(self.size), 0)
        self.used = dict.fromkeys(range(self.size), 0)
        self.up: set[int] = set()
        self.published = 0

    def event(self, index: int, stamp: int) -> bool:
        self.stamp[index] = stamp
        present = [self.stamp[i] for i in self.up]
        if not present or max(present) <= self.published:
            return False
        coherent = max(present) - min(present) <= self.window
        if not coherent or any(self.stamp[i] <= self.used[i] for i in self.up):
            return False
        self.published = max(present)
        self.used.update({i: self.stamp[i] for i in self.up})
        return True


indices = st.integers(0, SIZE - 1)
# Weighted towards whole ticks, so that complete orbits do occur.
ticks_of_events = st.lists(
    st.one_of(
        st.tuples(st.just("event"), indices, st.integers(0, 3)),
        st.tuples(st.just("tick"), st.permutations(range(SIZE)), st.integers(0, 3)),
        st.tuples(st.just("link"), indices, st.booleans()),
    ),
    min_size=5,
    max_size=30,
)


@settings(max_examples=200)
@given(script=ticks_of_events, skew=st.integers(0, 3), window=st.integers(0, 3))
def test_every_published_orbit_is_coherent_and_new_whatever_comes(script, skew, window):
    """Stamps may even go back here: safety needs no assumption on the server."""
    assembler = connected(window=window * 1e-3)
    published: list[int] = []
    used = np.zeros(SIZE, dtype=np.int64)
    for kind, what, argument in script:
        if kind == "link":
            assembler.set_connected(what, argument)
            continue
        for index in [what] if kind == "event" else what:
            stamp = stamp_of(argument) + (index % 2) * skew * 1_000_000
            snapshot = send(assembler, index, stamp, value=float(stamp))
            if snapshot is None:
                continue
            present = assembler.connected
            stamps = np.where(present, snapshot.values, np.nan)[present].astype(np.int64)
            assert np.ptp(stamps) <= window * 1_000_000
            assert stamps.max() == snapshot.stamp
            assert not published or snapshot.stamp > published[-1]
            assert (stamps > used[present]).all()
            np.testing.assert_array_equal(snapshot.valid, present)
            assert np.isnan(snapshot.values[~present]).all()
            used[present] = stamps
            published.append(snapshot.stamp)


@given(
    events=st.lists(st.tuples(indices, st.integers(0, 2)), max_size=150),
    skew=st.integers(0, 3),
    window=st.integers(0, 3),
)
def test_counting_finds_the_same_orbits_as_looking_after_every_event(events, skew, window):
    """Stamps of a channel do not go back, channels stay: then nothing is found late or missed."""
    assembler, model = connected(window=window * 1e-3), Model(SIZE, window * 1_000_000)
    model.up = set(range(SIZE))
    now = dict.fromkeys(range(SIZE), 0)
    for index, ahead in events:
        now[index] = min(now[index] + ahead, min(now.values()) + 2)
        stamp = stamp_of(now[index]) + (index % 2) * skew * 1_000_000
        found = send(assembler, index, stamp) is not None
        assert found == model.event(index, stamp)


@given(order=st.permutations(range(SIZE)), ticks=st.integers(1, 5))
def test_undisturbed_ticks_are_all_found_at_their_last_event_with_one_look_each(order, ticks):
    assembler = connected()
    for index in order:  # first tick: the assembler does not know yet what to expect
        send(assembler, index, stamp_of(0))
    before = assembler.checks
    for tick in range(1, ticks + 1):
        found = [send(assembler, index, stamp_of(tick)) is not None for index in order]
        assert found == [False] * (SIZE - 1) + [True]
    assert assembler.checks - before == ticks


def test_two_ticks_interleaved_publish_only_the_newer():
    assembler = connected(size=3)
    events = [(0, 1), (1, 1), (0, 2), (2, 1), (1, 2), (2, 2)]
    found = [send(assembler, index, stamp_of(tick), float(tick)) for index, tick in events]
    assert [snapshot is not None for snapshot in found] == [False] * 5 + [True]
    assert found[-1] is not None
    np.testing.assert_array_equal(found[-1].values, [2.0, 2.0, 2.0])


def test_a_repeated_stamp_is_never_published_again():
    assembler = connected()
    for _ in range(3):
        found = [send(assembler, index, stamp_of(1)) for index in range(SIZE)]
    assert found == [None] * SIZE


def test_one_stuck_channel_costs_one_look_per_tick():
    size, ticks = 180, 50
    assembler = connected(size)
    for tick in range(ticks):
        for index in range(size - 1):
            assert send(assembler, index, stamp_of(tick)) is None
    assert assembler.checks <= ticks + 2


def test_a_vector_is_not_completed_by_channels_that_drop_out():
    assembler = connected(size=3)
    for index in range(3):
        send(assembler, index, stamp_of(1))
    send(assembler, 0, stamp_of(2))
    assembler.set_connected(1, False)
    assembler.set_connected(2, False)
    assert assembler.snapshot().stamp == stamp_of(1)


def test_a_disconnected_channel_is_not_waited_for_and_a_returned_one_is():
    assembler = connected(size=3)
    assembler.set_connected(1, False)
    send(assembler, 0, stamp_of(1))
    snapshot = send(assembler, 2, stamp_of(1))
    assert snapshot is not None
    np.testing.assert_array_equal(snapshot.valid, [True, False, True])
    assembler.set_connected(1, True)
    assert send(assembler, 0, stamp_of(2)) is None
    assert send(assembler, 2, stamp_of(2)) is None
    assert send(assembler, 1, stamp_of(2)) is not None


def outage_of_four_and_return_of_two() -> Assembler:
    """One BPM is away all the time, then all are, then two of the other four come back."""
    assembler = connected()
    assembler.set_connected(4, False)
    for index in range(4):
        send(assembler, index, stamp_of(1))
    for index in range(4):
        assembler.set_connected(index, False)
    for index in range(2):
        assembler.set_connected(index, True)
    for tick in (2, 3):
        assert [send(assembler, index, stamp_of(tick)) for index in range(2)] == [None, None]
    return assembler


def test_after_an_outage_the_orbit_waits_for_all_that_were_there():
    assembler = outage_of_four_and_return_of_two()
    assert assembler.describe(NAMES).startswith("2 of 5 BPMs are back after an outage")
    for index in (2, 3):
        assembler.set_connected(index, True)
    found = [send(assembler, index, stamp_of(4)) is not None for index in range(4)]
    assert found == [False, False, False, True]


def test_channels_that_stay_away_after_an_outage_are_given_up_at_the_second_look():
    assembler = outage_of_four_and_return_of_two()
    assembler.look()
    assert [send(assembler, index, stamp_of(4)) for index in range(2)] == [None, None]
    assembler.look()
    found = [send(assembler, index, stamp_of(5)) for index in range(2)]
    assert found[0] is None
    assert found[1] is not None
    np.testing.assert_array_equal(found[1].valid, np.arange(SIZE) < 2)


@pytest.mark.parametrize(
    ("value", "severity"), [(1.0, INVALID), (np.nan, 0), (np.inf, 0), (-np.inf, 0)]
)
def test_invalid_and_not_finite_readings_are_masked(value, severity):
    assembler = connected(size=2)
    send(assembler, 0, stamp_of(1), 0.5)
    snapshot = send(assembler, 1, stamp_of(1), value, severity)
    assert snapshot is not None
    np.testing.assert_array_equal(snapshot.valid, [True, False])
    np.testing.assert_array_equal(snapshot.values, [0.5, np.nan])


def test_minor_and_major_alarms_are_valid():
    assembler = connected(size=2)
    send(assembler, 0, stamp_of(1), severity=1)
    snapshot = send(assembler, 1, stamp_of(1), severity=2)
    assert snapshot is not None
    assert snapshot.valid.all()


def test_the_missing_channel_is_named():
    assembler = connected()
    for index in range(SIZE - 1):
        send(assembler, index, stamp_of(2))
    text = assembler.describe(NAMES)
    assert text == ("4 of 5 BPMs carry stamp 1990-01-01T00:16:40.004+00:00, BPM:4 still at none")


def test_description_of_silence():
    assembler = Assembler(SIZE)
    assert assembler.describe(NAMES) == "all 5 BPM channels are disconnected"
    assembler.set_connected(0, True)
    assert assembler.describe(NAMES) == (
        "none of 1 connected BPMs has sent a reading; 4 disconnected"
    )
    send(assembler, 0, stamp_of(1))
    assert "1 of 5 BPMs still carry stamp" in assembler.describe(NAMES)
    send(assembler, 0, stamp_of(0))
    assert "stamps went back" in assembler.describe(NAMES)


def tick(assembler: Assembler, number: int, without: tuple[int, ...] = ()):
    """Send a tick; the snapshots that came of it."""
    sent = (send(assembler, i, stamp_of(number)) for i in range(SIZE) if i not in without)
    return [snapshot for snapshot in sent if snapshot is not None]


def stuck_ready(most: int = 2) -> Assembler:
    assembler = Assembler(SIZE, 0.0, most)
    for index in range(SIZE):
        assembler.set_connected(index, True)
    assert tick(assembler, 0)
    return assembler


def test_a_channel_that_keeps_its_stamp_costs_one_vector_and_comes_back():
    assembler = stuck_ready()
    assert tick(assembler, 1, (3,)) == []
    for number in range(2, 6):
        (snapshot,) = tick(assembler, number, (3,))
        assert snapshot.valid.tolist() == [True, True, True, False, True]
        assert np.isnan(snapshot.values[3]) and snapshot.stamp == stamp_of(number)
    assert len(tick(assembler, 6)) == 1  # it sends again: from the next tick on it counts
    (snapshot,) = tick(assembler, 7)
    assert snapshot.valid.all()


def test_more_than_may_be_stuck_are_a_torn_orbit():
    assembler = stuck_ready(most=1)
    for number in range(1, 5):
        assert tick(assembler, number, (2, 3)) == []


def test_who_is_only_late_within_a_tick_is_not_stuck():
    assembler = stuck_ready()
    for index in (0, 1, 2, 2, 2):  # repetitions make it look in the middle of a tick
        assert send(assembler, index, stamp_of(1)) is None
    assert send(assembler, 3, stamp_of(1)) is None
    snapshot = send(assembler, 4, stamp_of(1))
    assert snapshot is not None and snapshot.valid.all()


def test_what_a_channel_said_before_it_went_away_is_forgotten():
    assembler = connected()
    assert all(send(assembler, i, stamp_of(1), 7.0) is None for i in range(SIZE - 1))
    assert send(assembler, SIZE - 1, stamp_of(1), 7.0).valid.all()
    assembler.set_connected(2, False)
    assembler.set_connected(2, True)  # it may have been restarted, and has not said a word yet
    assert usable(assembler.records).tolist() == [True, True, False, True, True]
    send(assembler, 2, stamp_of(2), 0.0)
    assert usable(assembler.records).all()
