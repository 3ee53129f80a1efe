import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pydantic import ValidationError

from orbitfb.safety.limits import LimitSettings, limit
from orbitfb.safety.verdict import Action

M = 5
finite = st.floats(allow_nan=False, allow_infinity=False)
anything = st.floats()
settings = st.builds(
    LimitSettings,
    setpoint=st.floats(1e-6, 1e6),
    change_per_tick=st.floats(1e-6, 1e6),
)


@given(change=arrays(float, M, elements=finite), at=arrays(float, M, elements=finite), s=settings)
def test_limits_hold_for_any_finite_input(change, at, s):
    limited = limit(change, at, s)
    assert np.isfinite(limited.change).all()
    assert np.isfinite(limited.setpoints).all()
    assert (np.abs(limited.change) <= s.change_per_tick).all()
    assert (np.abs(limited.setpoints) <= np.maximum(s.setpoint, np.abs(at))).all()
    assert 0.0 <= limited.scale <= 1.0


@given(
    change=arrays(float, M, elements=st.floats(-1e3, 1e3)),
    at=arrays(float, M, elements=st.floats(-30, 30)),
    s=settings,
)
def test_the_direction_is_kept_and_nothing_goes_further_out(change, at, s):
    limited = limit(change, at, s)
    np.testing.assert_allclose(
        limited.change, limited.scale * change, rtol=1e-12, atol=1e-14 * s.change_per_tick
    )
    beyond = np.abs(at) > s.setpoint
    assert (np.abs(limited.setpoints[beyond]) <= np.abs(at[beyond])).all()
    assert (np.abs(limited.setpoints[~beyond]) <= s.setpoint).all()
    untouched = (np.abs(change) <= s.change_per_tick) & (np.abs(at + change) <= s.setpoint)
    if untouched.all():
        assert limited.scale == 1.0
        assert limited.verdict.action is Action.OK


@given(
    change=arrays(float, M, elements=anything),
    at=arrays(float, M, elements=anything),
    s=settings,
)
def test_nothing_non_finite_ever_leaves(change, at, s):
    limited = limit(change, at, s)
    assert np.isfinite(limited.change).all()
    bad = not (np.isfinite(change).all() and np.isfinite(at).all())
    assert (limited.verdict.action is Action.TRIP) == bad
    if bad:
        assert not limited.change.any()
        assert "not finite" in limited.verdict.reason


def test_a_corrector_at_its_limit_says_that_the_loop_stands_still():
    s = LimitSettings(setpoint=17.5)
    limited = limit(np.array([0.1, 0.1]), np.array([17.5, 0.0]), s, ("C30-H1", "C30-H2"))
    assert limited.scale == 0.0
    assert limited.at_limit.tolist() == [True, False]
    assert limited.verdict.action is Action.WARN
    assert "C30-H1" in limited.verdict.reason
    assert "stands still" in limited.verdict.reason


def test_a_setpoint_beyond_its_limit_may_move_inwards_at_full_length():
    limited = limit(np.array([-1.0, 0.5]), np.array([18.0, 0.0]), LimitSettings(setpoint=17.5))
    assert limited.scale == 1.0
    np.testing.assert_array_equal(limited.setpoints, [17.0, 0.5])


def test_the_largest_step_scales_the_whole_vector():
    limited = limit(np.array([4.0, -1.0]), np.zeros(2), LimitSettings(change_per_tick=2.0))
    np.testing.assert_allclose(limited.change, [2.0, -0.5])
    assert limited.scale == 0.5


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
@pytest.mark.parametrize("key", ["setpoint", "change_per_tick"])
def test_limits_are_finite_and_positive(key, value):
    with pytest.raises(ValidationError, match=key):
        LimitSettings(**{key: value})


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_nan_does_not_pass_a_clamp(bad):
    """np.clip(nan) is nan, and min(nan, x) depends on the order: neither may decide."""
    change = np.array([0.1, bad, 0.1])
    limited = limit(change, np.zeros(3), LimitSettings())
    assert limited.verdict.action is Action.TRIP
    assert not limited.change.any() and not limited.setpoints.any()
    unknown = limit(np.full(3, 0.1), np.array([0.0, bad, 0.0]), LimitSettings())
    assert unknown.verdict.action is Action.TRIP and not unknown.change.any()
