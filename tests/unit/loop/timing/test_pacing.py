import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orbitfb.loop.timing.pacing import Pace, miss, see, take


def drive(stamps, period):
    """Acted stamps and the missed counts, for orbits received when they are stamped."""
    pace, acted, missed = Pace(), [], []
    for stamp in stamps:
        due, pace = see(stamp, pace, period)
        if due:
            count, pace = take(stamp, stamp, pace, period)
            acted.append(stamp)
            missed.append(count)
    return acted, missed


@given(st.lists(st.floats(-0.02, 0.02), min_size=2, max_size=60), st.floats(0.99, 1.01))
def test_a_machine_at_the_rate_of_the_loop_is_never_passed_over(jitter, drift):
    stamps = [1e9 + 0.1 * drift * i + j for i, j in enumerate(jitter)]
    acted, missed = drive(stamps, 0.1)
    assert acted == stamps
    assert sum(missed) == 0


@pytest.mark.parametrize("factor", [2, 3, 10])
def test_a_faster_machine_has_every_kth_orbit_taken_once_its_rate_is_known(factor):
    random = np.random.default_rng(1)
    stamps = 0.1 / factor * (np.arange(400) + random.uniform(-0.1, 0.1, 400))
    acted, missed = drive(1e9 + stamps, 0.1)
    settled = np.array(acted) > 1e9 + stamps[50]
    np.testing.assert_allclose(np.diff(np.array(acted)[settled]), 0.1, atol=0.021 / factor)
    assert sum(missed) == 0


def test_gaps_are_counted_once_whether_seen_in_time_or_afterwards():
    pace = Pace()
    _, pace = see(0.0, pace, 0.1)
    _, pace = take(0.0, 100.0, pace, 0.1)
    total = 0
    for now in (100.15, 100.30, 100.45):
        count, pace = miss(now, pace, 0.1)
        total += count
    assert total == 4
    count, pace = take(1.0, 101.0, pace, 0.1)
    assert total + count == 9


def test_a_stepped_clock_is_no_heap_of_missed_orbits_and_no_deadlock():
    pace = Pace()
    for stamp, received in ((0.0, 0.0), (0.1, 0.1)):
        _, pace = see(stamp, pace, 0.1)
        _, pace = take(stamp, received, pace, 0.1)
    _, pace = see(3600.0, pace, 0.1)
    missed, pace = take(3600.0, 0.2, pace, 0.1)
    assert missed <= 1
    due, pace = see(5.0, pace, 0.1)
    assert due
    missed, pace = take(5.0, 0.3, pace, 0.1)
    assert missed == 0
    due, _ = see(5.1, pace, 0.1)
    assert due
