"""Masking and solving anew under any input: who is left out stays, the rest correct the orbit."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scripted import RESPONSE, M, N

from orbitfb.policies.masking import without
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.limits import LimitSettings, limit

POLICY = SvdPolicy(RESPONSE, SvdSettings(gain=1.0))
masks = st.lists(st.booleans(), min_size=M, max_size=M).map(np.array)
valids = st.lists(st.booleans(), min_size=N, max_size=N).map(np.array)
errors = st.lists(st.floats(-1e-3, 1e-3), min_size=N, max_size=N).map(np.array)


def radius(policy, valid):
    """Largest factor of the orbit at the valid BPMs from tick to tick."""
    units = np.eye(N)[valid]
    changes = np.array([policy.act(unit, valid, policy.initial_state())[0] for unit in units])
    step = np.eye(len(units)) + RESPONSE[valid] @ changes.T
    return np.abs(np.linalg.eigvals(step)).max()


@settings(max_examples=60, deadline=None, derandomize=True)
@given(lost=masks, valid=valids, error=errors, again=masks)
def test_any_correctors_and_bpms_may_be_missing(lost, valid, error, again):
    if lost.all() or not valid.any():
        return
    policy = without(POLICY, lost)
    seen = np.where(valid, error, 0.0)
    change, _ = policy.act(seen, valid, policy.initial_state())
    assert np.isfinite(change).all() and not change[lost].any()
    assert radius(policy, valid) <= 1.0 + 1e-9  # no part of the orbit grows tick by tick
    both = lost | again
    if not both.all():  # in any order
        twice = without(without(POLICY, lost), again)
        once = without(POLICY, both)
        one, other = (its.act(seen, valid, its.initial_state())[0] for its in (once, twice))
        np.testing.assert_allclose(one, other, atol=1e-12)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(
    change=st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=M, max_size=M),
    now=st.lists(st.floats(-20.0, 20.0), min_size=M, max_size=M),
    steps=st.integers(1, 5),
)
def test_no_row_of_changes_ever_leads_beyond_a_limit(change, now, steps):
    rules, setpoints = LimitSettings(setpoint=10.0, change_per_tick=2.0), np.array(now)
    for _ in range(steps):
        limited = limit(np.array(change), setpoints, rules)
        assert np.isfinite(limited.setpoints).all()
        assert (np.abs(limited.setpoints) <= np.maximum(10.0, np.abs(setpoints))).all()
        assert (np.abs(limited.setpoints - setpoints) <= 2.0 + 1e-12).all()
        setpoints = limited.setpoints
