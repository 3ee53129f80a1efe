"""The noise-aware law against its formula, its limits, and a Riccati equation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are

from orbitfb.core.errors import ConfigError, RingError
from orbitfb.physics.places import Ring
from orbitfb.physics.response import quadrupole_displacement_response, response
from orbitfb.policies.modal import (
    ModalPolicy,
    ModalSettings,
    default_gains,
    kalman_gain,
    left_modes,
)
from orbitfb.policies.svd import SvdPolicy, SvdSettings


def make_response(seed=0, bpms=12, correctors=9):
    return 1e-3 * np.random.default_rng(seed).normal(size=(bpms, correctors))


def act(policy, error):
    return policy.act(error, np.ones(len(error), dtype=bool), None)[0]


def formula(policy, error):
    """The law, written down mode by mode."""
    total = np.zeros(policy.response.shape[1])
    for i, mode in enumerate(policy.modes.T):
        z, gain, delta = float(mode @ error), policy.gains[i], policy.thresholds[i]
        far, near = policy.inverse @ mode, gain * policy.near_inverse @ mode
        if np.isinf(delta):
            total -= near * z
        elif delta == 0.0:
            total -= far * z
        else:
            total -= far * z - (far - near) * delta * np.tanh(z / delta)
    return total


@settings(max_examples=30, deadline=None)
@given(
    st.integers(0, 999),
    st.integers(1, 10),
    st.integers(1, 10),
    st.floats(-8.0, -3.0),
    st.floats(0.0, 1e-3),
    st.sampled_from([1.0, 0.05]),
)
def test_it_is_its_formula(seed, bpms, correctors, size, strength, share):
    rng = np.random.default_rng(seed)
    thresholds = rng.choice([0.0, 1e-6, 3e-5, np.inf], size=bpms)
    policy = ModalPolicy(
        make_response(seed, bpms, correctors),
        ModalSettings(regularisation=strength, near_caution=share),
        gains=rng.choice([0.01, 0.3, 1.0], size=bpms),
        thresholds=thresholds,
    )
    error = 10.0**size * rng.normal(size=bpms)
    expected = formula(policy, error)
    scale = np.abs(policy.near_inverse).max() * np.abs(error).max()
    tolerance = {"rtol": 1e-8, "atol": 1e-12 * scale}
    np.testing.assert_allclose(act(policy, error), expected, **tolerance)
    np.testing.assert_allclose(policy.changes(np.array([error]))[0], expected, **tolerance)


def test_far_away_it_is_the_inverse_and_near_zero_it_has_its_gains():
    policy = ModalPolicy(make_response(), ModalSettings(), gains=0.1, thresholds=1e-6)
    far, near = np.zeros((2, 12))
    far[:], near[:] = policy.modes[:, 3], policy.modes[:, 3] * 1e-10
    np.testing.assert_allclose(act(policy, far), -policy.inverse @ far, rtol=2e-6)
    np.testing.assert_allclose(act(policy, near), -0.1 * policy.inverse @ near, rtol=1e-6)


def test_without_thresholds_and_with_one_gain_it_is_the_svd_law():
    matrix = make_response()
    linear = ModalPolicy(matrix, ModalSettings(regularisation=7e-5), gains=0.5, thresholds=np.inf)
    plain = SvdPolicy(matrix, SvdSettings(gain=0.5, regularisation=7e-5))
    np.testing.assert_allclose(linear.gain_matrix, plain.gain_matrix, rtol=1e-9, atol=1e-9)


def test_doubt_about_the_response_makes_it_cautious():
    matrix = make_response()
    root = 1e-4 * np.random.default_rng(2).normal(size=(9, 9))
    covariance = root @ root.T
    policy = ModalPolicy(matrix, ModalSettings(), covariance=covariance)
    expected = np.linalg.solve(matrix.T @ matrix + 12 * covariance, matrix.T)
    np.testing.assert_allclose(policy.inverse, expected, rtol=1e-9)


def test_near_zero_a_share_of_the_caution_counts():
    """The slope at zero is that of an inverse with a share of λ² and of the doubt."""
    matrix = make_response()
    root = 3e-4 * np.random.default_rng(2).normal(size=(9, 9))
    covariance, gains = root @ root.T, np.linspace(0.05, 0.9, 12)
    policy = ModalPolicy(
        matrix,
        ModalSettings(regularisation=2e-4, near_caution=0.1),
        gains=gains,
        covariance=covariance,
    )
    square = matrix.T @ matrix
    damping = 12 * covariance + 4e-8 * np.eye(9)
    far = np.linalg.solve(square + damping, matrix.T)
    near = np.linalg.solve(square + 0.1 * damping, matrix.T)
    slope = near @ policy.modes @ np.diag(gains) @ policy.modes.T
    np.testing.assert_allclose(policy.gain_matrix, slope, rtol=1e-9)
    tiny, large = 1e-12 * np.ones(12), 1.0 * np.ones(12)
    np.testing.assert_allclose(act(policy, tiny), -slope @ tiny, rtol=1e-8)
    np.testing.assert_allclose(act(policy, large), -far @ large, rtol=1e-4)


@pytest.mark.parametrize("ratio", [1e-4, 0.04, 1.0, 30.0])
def test_the_kalman_gain_solves_the_riccati_equation(ratio):
    q, r = ratio * 4e-14, 4e-14
    one = np.ones((1, 1))
    predicted = solve_discrete_are(one, one, ratio * one, one)[0, 0]
    assert kalman_gain(q, r) == pytest.approx(predicted / (predicted + 1.0), rel=1e-9)


def test_no_other_gain_keeps_a_random_walk_closer():
    """Stationary true variance of x' = x − L (x + v) + w, from its own equation."""
    q, r = 0.3, 1.0

    def variance(gain):
        return (q + gain**2 * r) / (1.0 - (1.0 - gain) ** 2)

    best = float(kalman_gain(q, r))
    assert all(variance(best) < variance(factor * best) for factor in (0.9, 0.99, 1.01, 1.1))


def test_the_default_gains_follow_the_power_of_a_mode():
    matrix, chosen = make_response(), ModalSettings(ground=0.1e-6, minimum_gain=0.01)
    modes = left_modes(matrix)
    gains = default_gains(matrix, modes, chosen)
    sigma = np.linalg.svd(matrix, compute_uv=False)
    power = np.concatenate([sigma**2, np.zeros(3)])
    steps = 0.1e-6**2 * power / np.mean(power)
    assert np.mean(steps) == pytest.approx(0.1e-6**2)  # mean over the modes = mean over the BPMs
    np.testing.assert_allclose(gains[:9], kalman_gain(steps[:9], chosen.reading_noise**2))
    np.testing.assert_array_equal(gains[9:], 0.01)
    still = default_gains(matrix, modes, ModalSettings(ground=0.0, minimum_gain=0.05))
    np.testing.assert_array_equal(still, 0.05)


@pytest.mark.parametrize("plane", ["x", "y"])
def test_on_the_default_ring_the_prior_is_near_what_quadrupoles_do(plane):
    """The claim of the module: within 2 for the modes that get more than the smallest gain."""
    ring = Ring.load()
    matrix = response(ring, plane)
    modes, sigma, _ = np.linalg.svd(matrix)
    by_quadrupoles = np.sum((modes.T @ quadrupole_displacement_response(ring, plane)) ** 2, axis=1)
    ratio = (by_quadrupoles / by_quadrupoles.mean()) / (sigma**2 / np.mean(sigma**2))
    counts = default_gains(matrix, modes, ModalSettings()) > ModalSettings().minimum_gain
    assert counts.sum() > 20
    assert np.all((ratio[counts] > 0.5) & (ratio[counts] < 2.0))


def test_masked_bpms_are_not_heard_and_hardly_missed():
    """A smooth orbit is corrected nearly as well when three of many BPMs are masked."""
    ring = Ring.load()
    matrix = response(ring, "x")
    policy = ModalPolicy(matrix, ModalSettings(regularisation=7e-5))
    orbit = quadrupole_displacement_response(ring, "x") @ (
        1e-6 * np.random.default_rng(0).normal(size=300)
    )
    valid = np.ones(180, dtype=bool)
    valid[[5, 60, 61]] = False
    heard = np.where(valid, orbit, np.nan)
    left = orbit + matrix @ policy.act(heard, valid, None)[0]
    best = orbit + matrix @ act(policy, orbit)
    assert np.linalg.norm(left) < 0.1 * np.linalg.norm(orbit)
    assert np.linalg.norm(best) < np.linalg.norm(left)


def test_its_name_follows_its_content():
    matrix, chosen = make_response(), ModalSettings()
    name = ModalPolicy(matrix, chosen).policy_id
    assert name.startswith("modal-")
    assert name == ModalPolicy(matrix.copy(order="F"), chosen).policy_id
    others = [
        ModalPolicy(1.01 * matrix, chosen),
        ModalPolicy(matrix, ModalSettings(threshold=4.0)),
        ModalPolicy(matrix, chosen, modes=np.eye(12)),
        ModalPolicy(matrix, chosen, gains=0.3),
        ModalPolicy(matrix, chosen, thresholds=1e-5),
        ModalPolicy(matrix, chosen, covariance=np.eye(9)),
    ]
    assert len({name, *(other.policy_id for other in others)}) == 7
    assert ModalPolicy(matrix, chosen, policy_id="golden").policy_id == "golden"


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({"modes": np.eye(9)}, RingError, r"must be \(12, 12\)"),
        ({"modes": 2.0 * np.eye(12)}, RingError, "not orthonormal"),
        ({"modes": np.full((12, 12), np.nan)}, RingError, "not orthonormal"),
        ({"gains": np.ones(9)}, RingError, "one for each of 12 modes"),
        ({"gains": 1.1}, ConfigError, "between 0 and 1"),
        ({"gains": np.nan}, ConfigError, "gains lie between"),
        ({"thresholds": -1e-6}, ConfigError, "thresholds lie between"),
        ({"covariance": np.eye(3)}, RingError, r"\(9, 9\)"),
    ],
)
def test_what_makes_no_law_is_refused(given, error, words):
    with pytest.raises(error, match=words):
        ModalPolicy(make_response(), ModalSettings(), **given)


def test_without_some_bpms_it_is_the_law_of_the_others():
    """What is filled in carries the noise of its neighbours: the floor rose by a tenth."""
    matrix = response(Ring.load(), "x")
    valid = np.ones(len(matrix), dtype=bool)
    valid[np.random.default_rng(1).choice(len(valid), 9, replace=False)] = False
    law, others = (
        ModalPolicy(rows, ModalSettings(threshold=None)) for rows in (matrix, matrix[valid])
    )
    error = 0.2e-6 * np.random.default_rng(2).normal(size=len(matrix))
    expected = others.act(error[valid], valid[valid], None)[0]
    error[~valid] = np.nan
    change = law.act(error, valid, None)[0]
    assert np.linalg.norm(change - expected) < 0.03 * np.linalg.norm(expected)
    assert not law.act(error, np.zeros_like(valid), None)[0].any()
