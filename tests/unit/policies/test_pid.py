"""Integral and derivative against a digital filter of the same transfer function."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from orbitfb.core.errors import ConfigError
from orbitfb.policies.pid import PidSettings, first_state, step
from orbitfb.policies.svd import SvdPolicy, SvdSettings

WIDE = {"integral_limit": 1e9, "derivative_limit": 1e9}


def by_steps(chosen, corrections):
    state, changes = first_state(corrections.shape[1]), []
    for correction in corrections:
        change, state = step(chosen, correction, b"", state)
        changes.append(change)
    return np.array(changes)


def by_filters(chosen, corrections):
    """P + I / (1 − z⁻¹) + D (1 − φ)(1 − z⁻¹) / (1 − φ z⁻¹), the first difference left out."""
    kept = chosen.derivative_filter
    summed = lfilter([chosen.integral_gain], [1.0, -1.0], corrections, axis=0)
    numerator = chosen.derivative_gain * (1.0 - kept) * np.array([1.0, -1.0])
    moved = corrections - corrections[0]  # a law that has seen nothing before takes no difference
    slope = lfilter(numerator, [1.0, -kept], moved, axis=0)
    return -(chosen.gain * corrections + summed + slope)


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 999),
    st.floats(0.05, 2.0, exclude_max=True),
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
    st.floats(0.0, 0.95),
)
def test_it_is_its_transfer_function(seed, gain, integral, derivative, kept):
    chosen = PidSettings(
        gain=gain,
        integral_gain=integral,
        derivative_gain=derivative,
        derivative_filter=kept,
        **WIDE,
    )
    corrections = np.random.default_rng(seed).normal(size=(30, 3))
    np.testing.assert_allclose(
        by_steps(chosen, corrections), by_filters(chosen, corrections), rtol=1e-9, atol=1e-9
    )


def test_the_closed_loop_is_the_solution_of_its_difference_equation():
    """e_{n+1} = e_n − P e_n − D (e_n − e_{n−1}):  z² − (1 − P − D) z − D = 0."""
    response = 1e-3 * np.random.default_rng(0).normal(size=(9, 9))
    chosen = SvdSettings(gain=0.6, derivative_gain=0.2, regularisation=0.0, **WIDE)
    policy = SvdPolicy(response, chosen)
    error, state, valid = np.ones(9) * 1e-4, policy.initial_state(), np.ones(9, dtype=bool)
    roots = np.roots([1.0, -(1.0 - 0.6 - 0.2), -0.2])
    weights = np.linalg.solve(np.vander(roots, 2, increasing=True).T, [1.0, 1.0 - 0.6])
    for tick in range(25):
        np.testing.assert_allclose(error, 1e-4 * (weights @ roots**tick), rtol=1e-6, atol=1e-13)
        change, state = policy.act(error, valid, state)
        error = error + response @ change


def test_a_little_derivative_quickens_a_loop_with_latency():
    """One tick late: z² − z + P = 0 and z³ − z² + (P + D) z − D = 0, slowest roots 0.55 and 0.5."""

    def left(derivative):
        chosen = PidSettings(gain=0.3, derivative_gain=derivative, **WIDE)
        error, on_its_way, state = np.ones(1), np.zeros(1), first_state(1)
        for _ in range(40):
            change, state = step(chosen, error, b"", state)
            error, on_its_way = error + on_its_way, change
        return abs(float(error[0]))

    assert left(0.05) < 0.2 * left(0.0)


@pytest.mark.parametrize("gains", [{"integral_gain": 0.1}, {"derivative_gain": 0.5}])
def test_the_shares_are_limited(gains):
    chosen = PidSettings(**gains, integral_limit=1e-3, derivative_limit=1e-3)
    state = first_state(4)
    for size in (1.0, 50.0, 1.0, -70.0):
        change, state = step(chosen, size * np.ones(4), b"", state)
        share = change + chosen.gain * size
        assert np.sqrt(np.mean(share**2)) <= 1.0000001e-3


def test_while_changes_are_shortened_nothing_winds_up_and_then_nothing_jumps():
    """The loop hands the old state in again as long as its limits shorten the change."""
    chosen = SvdSettings(integral_gain=0.2, derivative_gain=0.5, regularisation=0.0)
    response = 1e-3 * np.random.default_rng(1).normal(size=(6, 6))
    policy = SvdPolicy(response, chosen)
    valid, before = np.ones(6, dtype=bool), policy.initial_state()
    far, near = response @ np.ones(6), 1e-4 * response @ np.ones(6)
    _, before = policy.act(far, valid, before)
    for _ in range(100):
        policy.act(far, valid, before)  # what it returns is not kept
    change, after = policy.act(near, valid, before)
    expected = chosen.integral_limit + chosen.derivative_limit + chosen.gain * 1e-4
    assert np.sqrt(np.mean(change**2)) <= expected * 1.000001
    assert np.sqrt(np.mean(after.integral**2)) <= chosen.integral_limit * 1.000001


def test_no_difference_is_formed_across_a_new_mask():
    chosen = SvdSettings(derivative_gain=1.0, regularisation=0.0, **WIDE)
    plain = SvdPolicy(
        response := 1e-3 * np.random.default_rng(2).normal(size=(6, 5)),
        SvdSettings(regularisation=0.0),
    )
    policy = SvdPolicy(response, chosen)
    every, some = np.ones(6, dtype=bool), np.arange(6) != 2
    error = 1e-4 * np.arange(1.0, 7.0)
    _, state = policy.act(error, every, policy.initial_state())
    change, state = policy.act(error, some, state)
    np.testing.assert_allclose(change, plain.act(error, some, plain.initial_state())[0])
    change, _ = policy.act(2.0 * error, some, state)  # the same mask again: now it counts
    proportional = plain.act(error, some, plain.initial_state())[0]
    np.testing.assert_allclose(change, 2.0 * proportional + proportional / chosen.gain, rtol=1e-9)


@pytest.mark.parametrize("gains", [{"integral_gain": 0.1}, {"derivative_gain": 0.1}])
def test_a_law_with_memory_does_not_decide_in_batches(gains):
    policy = SvdPolicy(np.eye(3), SvdSettings(**gains))
    with pytest.raises(ConfigError, match="depend on earlier orbits"):
        policy.changes(np.zeros((2, 3)))
