"""A few BPMs whose stamps are not those of the others neither stop nor mislead the orbit."""

import numpy as np
import pytest

from orbitfb.epics.orbit.assembler import Assembler
from orbitfb.epics.orbit.stray_stamps import common_stamp, difference
from orbitfb.epics.records import NANOSECONDS

SIZE, PERIOD = 12, NANOSECONDS // 10
START = 1_000_000 * NANOSECONDS
NAMES = tuple(f"BPM:{index}" for index in range(SIZE))
MS = 1_000_000


class Bpms:
    """Sends ticks of a ring some of whose BPMs have clocks of their own."""

    def __init__(self, most: int = 3, window: float = 0.0) -> None:
        self.time = 0.0
        self.assembler = Assembler(SIZE, window, most, lambda: self.time)
        for index in range(SIZE):
            self.assembler.set_connected(index, True)
        self.offset = dict.fromkeys(range(SIZE), 0)
        self.number = 0
        self.order = list(range(SIZE))

    def tick(self, count: int = 1):
        """Send whole ticks; returns the snapshots of each."""
        return [self._one() for _ in range(count)]

    def _one(self):
        self.number += 1
        self.time = 0.1 * self.number
        found = []
        for index in self.order:
            self.time += 1e-4
            stamp = START + self.number * PERIOD + self.offset[index]
            seconds, nanoseconds = divmod(stamp, NANOSECONDS)
            self.assembler.records[index] = (0, 0, seconds, nanoseconds, float(self.number))
            if self.assembler.arrived():
                found.append(self.assembler.snapshot())
        return found


@pytest.mark.parametrize("place", [0, 5, SIZE - 1])
@pytest.mark.parametrize(
    "offset", [MS, -MS, 10 * NANOSECONDS, -PERIOD, PERIOD, -3600 * NANOSECONDS, 1]
)
def test_one_bpm_with_another_stamp_costs_one_orbit_is_left_out_and_named(place, offset):
    if (place, offset) in ((0, -PERIOD), (SIZE - 1, PERIOD)):
        pytest.skip("its stamps are in step with what the others sent last")
    bpms = Bpms()
    bpms.tick(3)
    bpms.offset[place] = offset
    found = bpms.tick(20)
    missing = [not each for each in found]
    assert sum(missing) <= 2 and not any(missing[3:])
    for (snapshot,) in found[3:]:
        assert snapshot.valid.tolist() == [index != place for index in range(SIZE)]
        assert np.isnan(snapshot.values[place])
        assert set(snapshot.left_out) == {place}
    side = "ahead of" if offset > 0 else "behind"
    assert f"{side} the others" in found[-1][0].left_out[place]


@pytest.mark.parametrize("offset", [MS, -PERIOD])
def test_it_counts_again_once_its_stamp_is_that_of_the_others(offset):
    bpms = Bpms()
    bpms.tick(3)
    bpms.offset[0] = offset
    bpms.tick(5)
    bpms.offset[0] = 0
    found = bpms.tick(2)
    assert found[-1][0].valid.all() and not found[-1][0].left_out


@pytest.mark.parametrize("last", [1, 2])
def test_those_that_always_come_last_count_again_after_a_few_ticks(last):
    bpms = Bpms()
    bpms.tick(3)
    for index in range(SIZE - last, SIZE):
        bpms.offset[index] = MS
    bpms.tick(5)
    for index in range(SIZE - last, SIZE):
        bpms.offset[index] = 0
    assert not bpms.tick(3)[-1][0].valid.all()  # the orbit does not wait for them
    assert bpms.tick()[-1][0].valid.all()


def test_those_that_come_last_and_had_not_come_at_the_start_count_after_a_few_ticks():
    """At a fast ring two ticks may pass before the last subscription is answered."""
    bpms = Bpms()
    whole, bpms.order = bpms.order, bpms.order[:-2]
    assert bpms.tick(4)[-1][0].left_out.keys() == {10, 11}
    bpms.order = whole
    assert bpms.tick(5)[-1][0].valid.all()


def test_one_that_was_left_out_and_comes_a_tick_late_stays_out():
    """Before the others of the next tick it sends what they have sent at the last one."""
    bpms = Bpms()
    bpms.tick(3)
    bpms.offset[0] = MS
    bpms.tick(5)
    bpms.offset[0] = -PERIOD
    for (snapshot,) in bpms.tick(20):
        assert np.flatnonzero(~snapshot.valid).tolist() == [0]


def test_a_look_does_not_believe_one_that_still_strays():
    bpms = Bpms()
    bpms.tick(3)
    bpms.offset[4] = MS
    bpms.tick(5)
    for _ in range(5):
        bpms.assembler.look()
        ((snapshot,),) = bpms.tick()
        assert np.flatnonzero(~snapshot.valid).tolist() == [4]


def test_one_that_is_a_tick_late_is_not_believed_if_a_look_falls_into_a_tick():
    bpms = Bpms()
    bpms.tick(3)
    bpms.offset[5] = -PERIOD
    bpms.tick(5)
    late = bpms.assembler.records[5].copy()
    late["nanoseconds"] += PERIOD  # what it sends first at the next tick
    bpms.assembler.records[5] = late
    bpms.assembler.look()
    assert all(found and not found[0].valid[5] for found in bpms.tick(3))


def test_more_than_may_be_left_out_are_no_orbit_and_the_odd_ones_are_named():
    bpms = Bpms(most=3)
    bpms.tick(3)
    for index in range(4):
        bpms.offset[index] = MS
    assert bpms.tick(10) == [[]] * 10
    told = bpms.assembler.describe(NAMES)
    assert told.startswith("8 of 12 BPMs carry stamp")
    assert "BPM:0 stamped 1 ms ahead of the others" in told and "BPM:5" not in told


def test_any_number_of_those_that_do_not_count_may_stray_or_be_silent():
    bpms = Bpms(most=0)
    masked = np.arange(SIZE) < 6
    bpms.assembler.count(~masked)
    for index in range(5):
        bpms.offset[index] = (index + 1) * MS
    bpms.order.remove(5)
    found = bpms.tick(10)
    for (snapshot,) in found[4:]:
        np.testing.assert_array_equal(snapshot.valid, ~masked)


def test_two_halves_with_stamps_of_their_own_are_no_orbit():
    bpms = Bpms(most=SIZE)
    for index in range(SIZE // 2):
        bpms.offset[index] = MS
    assert bpms.tick(10) == [[]] * 10


def test_stamps_that_all_differ_are_told_with_how_far_they_lie_apart():
    bpms = Bpms()
    bpms.tick(3)
    assert bpms.assembler.apart is None
    bpms.offset = {index: index * MS for index in range(SIZE)}
    assert bpms.tick() == [[]]
    assert bpms.assembler.apart == pytest.approx((SIZE - 1) * 1e-3)
    few = Bpms(most=0)
    few.offset[3] = few.offset[5] = MS
    assert few.tick(3) == [[], [], []]
    assert few.assembler.apart is None  # `describe` names these


def test_the_common_stamp_is_that_of_the_largest_group():
    assert common_stamp(np.array([5, 5, 9, 5, 1]), 0) == 5
    assert common_stamp(np.array([5, 6, 9, 4, 1]), 2) == 6
    assert common_stamp(np.array([1, 2]), 0) == 2


def test_a_difference_is_told_with_its_unit():
    assert difference(MS) == "stamped 1 ms ahead of the others"
    assert difference(-3600 * NANOSECONDS) == "stamped 3.6e+03 s behind the others"
