"""Drive limits narrower than ours hold for their corrector, and for that one alone."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from orbitfb.safety.bounds import Bounds, narrower
from orbitfb.safety.limits import LimitSettings, at_limit, limit, near_limit

NAMES = ("A", "B", "C")
SETTINGS = LimitSettings(setpoint=10.0, change_per_tick=2.0)
DRIVE = np.array([[-18.0, 18.0], [-0.5, 0.5], [np.nan, np.nan]])
BOUNDS = Bounds.of(10.0, 3, DRIVE)


def test_the_narrower_of_both_holds_and_none_is_no_limit():
    np.testing.assert_array_equal(BOUNDS.low, [-10.0, -0.5, -10.0])
    np.testing.assert_array_equal(BOUNDS.high, [10.0, 0.5, 10.0])
    np.testing.assert_array_equal(BOUNDS.drive, [False, True, False])
    np.testing.assert_array_equal(BOUNDS.largest, [10.0, 0.5, 10.0])
    assert not Bounds.of(10.0, 3).drive.any()


def test_one_narrow_supply_shortens_the_change_and_is_named_with_its_limits():
    limited = limit(np.array([1.0, 1.0, 0.0]), np.zeros(3), SETTINGS, NAMES, BOUNDS)
    np.testing.assert_allclose(limited.setpoints, [0.5, 0.5, 0.0])
    np.testing.assert_array_equal(limited.at_limit, [False, True, False])
    assert "1 correctors at their drive limits: B (-0.5 to 0.5 A)" in limited.verdict.reason
    assert limit(np.array([1.0, 0.4, 0.0]), np.zeros(3), SETTINGS, NAMES, BOUNDS).scale == 1.0


@pytest.mark.parametrize("change", [0.3, -0.3])
def test_a_setpoint_beyond_a_drive_limit_is_not_put_as_it_would_jump(change):
    there = np.array([0.0, 0.9, 0.0])
    limited = limit(np.array([0.0, change, 0.0]), there, SETTINGS, NAMES, BOUNDS)
    np.testing.assert_array_equal(limited.change, np.zeros(3))
    np.testing.assert_array_equal(limited.at_limit, [False, True, False])
    # beyond our own limit it may come back: nothing would make it jump
    ours = limit(np.array([-0.3, 0.0, 0.0]), np.array([10.5, 0.0, 0.0]), SETTINGS, NAMES, BOUNDS)
    np.testing.assert_allclose(ours.change, [-0.3, 0.0, 0.0])


def test_a_setpoint_at_its_drive_limit_in_single_precision_may_leave_it():
    there = np.array([0.0, float(np.float32(0.5)) + 1e-6, 0.0])
    limited = limit(np.array([0.0, -0.1, 0.0]), there, SETTINGS, NAMES, BOUNDS)
    assert limited.scale == 1.0


def test_limits_on_one_side_of_zero():
    unipolar = Bounds.of(10.0, 1, np.array([[0.0, 5.0]]))
    assert limit(np.array([-0.1]), np.array([0.0]), SETTINGS, ("A",), unipolar).scale == 0.0
    assert limit(np.array([0.1]), np.array([0.0]), SETTINGS, ("A",), unipolar).scale == 1.0
    assert not near_limit(np.array([0.0]), SETTINGS, ("A",), unipolar)
    assert near_limit(np.array([4.6]), SETTINGS, ("A",), unipolar) == (
        "1 correctors beyond 90% of their limits: A (0 to 5 A)"
    )


@pytest.mark.parametrize("drive", [(-5.0, 18.0), (-18.0, 5.0)])
def test_one_side_that_is_narrower_is_enough(drive):
    assert Bounds.of(10.0, 1, np.array([drive])).drive.all()
    assert narrower(10.0, np.array([drive]), ("A",))


def test_it_is_told_which_are_narrower():
    assert not narrower(10.0, DRIVE[[0, 0, 2]], NAMES)
    assert narrower(10.0, DRIVE, NAMES) == (
        "1 correctors have drive limits narrower than limits.setpoint (10 A), which hold for "
        "them: B (-0.5 to 0.5 A)"
    )
    which = np.array([True, False, False])
    assert at_limit(which, SETTINGS, NAMES, BOUNDS) == "1 correctors at their limit of ±10 A (A)"


numbers = st.floats(-12.0, 12.0, allow_subnormal=False)


@example(
    change=[0.0, -1.0, 0.0], there=[0.0, -1.0, 0.0], drive=[(0.0, 0.0), (-2.0, -2.0), (0.0, 0.0)]
)
@given(
    change=st.lists(numbers, min_size=3, max_size=3),
    there=st.lists(numbers, min_size=3, max_size=3),
    drive=st.lists(st.tuples(numbers, numbers), min_size=3, max_size=3),
)
def test_no_setpoint_leaves_its_bounds_whatever_is_wanted(change, there, drive):
    limits = np.sort(np.array(drive), axis=1)
    bounds = Bounds.of(10.0, 3, limits)
    before = np.array(there)
    after = limit(np.array(change), before, SETTINGS, NAMES, bounds).setpoints
    assert (after <= np.maximum(bounds.high, before)).all()
    assert (after >= np.minimum(bounds.low, before)).all()
    stranded = bounds.stranded(before)
    np.testing.assert_array_equal(after[stranded], before[stranded])
