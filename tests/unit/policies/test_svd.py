"""The SVD policy against closed forms and against a plain least-squares solver."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orbitfb.core.errors import ConfigError, RingError
from orbitfb.policies.infill import NOISY
from orbitfb.policies.svd import SvdPolicy, SvdSettings

LAMBDA = 70e-6


def make_response(seed=0, bpms=12, correctors=9):
    return 1e-3 * np.random.default_rng(seed).normal(size=(bpms, correctors))


def all_valid(policy):
    return np.ones(policy.response.shape[0], dtype=bool)


def act(policy, error, valid=None, state=None):
    valid = all_valid(policy) if valid is None else valid
    return policy.act(error, valid, policy.initial_state() if state is None else state)


def tikhonov(response, error, strength):
    """Minimise |R a + e|² + λ²|a|² as one stacked least-squares problem: no SVD formula."""
    columns = response.shape[1]
    stacked = np.vstack([response, strength * np.eye(columns)])
    return np.linalg.lstsq(stacked, np.concatenate([-error, np.zeros(columns)]), rcond=None)[0]


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 999), st.integers(2, 14), st.integers(2, 14), st.sampled_from([7e-6, 7e-5, 1e-3])
)
def test_the_change_is_the_tikhonov_minimum_times_the_gain(seed, bpms, correctors, strength):
    response = make_response(seed, bpms, correctors)
    error = 1e-4 * np.random.default_rng(seed + 1).normal(size=bpms)
    policy = SvdPolicy(response, SvdSettings(gain=0.7, regularisation=strength))
    change, _ = act(policy, error)
    expected = 0.7 * tikhonov(response, error, strength)
    np.testing.assert_allclose(change, expected, rtol=1e-7, atol=1e-9 * np.abs(expected).max())


def test_without_regularisation_it_is_the_pseudo_inverse():
    response = make_response()
    policy = SvdPolicy(response, SvdSettings(gain=1.0, regularisation=0.0))
    np.testing.assert_allclose(policy.gain_matrix, np.linalg.pinv(response), rtol=1e-9)


def test_without_regularisation_a_rank_deficient_matrix_gives_the_pseudo_inverse():
    response = make_response()
    response[:, 4] = response[:, 2]
    policy = SvdPolicy(response, SvdSettings(gain=1.0, regularisation=0.0))
    np.testing.assert_allclose(
        policy.gain_matrix, np.linalg.pinv(response, rcond=1e-10), rtol=1e-7, atol=1e-9
    )


def test_the_cut_is_the_pseudo_inverse_of_the_best_approximation_of_that_rank():
    response = make_response()
    u, sigma, vt = np.linalg.svd(response)
    truncated = u[:, :4] @ np.diag(sigma[:4]) @ vt[:4]
    policy = SvdPolicy(response, SvdSettings(gain=1.0, regularisation=0.0, singular_values=4))
    np.testing.assert_allclose(
        policy.gain_matrix, np.linalg.pinv(truncated, rcond=1e-8), rtol=1e-8, atol=1e-9
    )


def filled(response, error, valid):
    """Give masked BPMs what the likeliest kicks of the correctors do there: kicks, not orbits."""
    known = response[valid]
    exact = known.T / (NOISY * np.sum(known**2, axis=1))  # over the variance that is no kick's
    kicks = np.linalg.solve(exact @ known + np.eye(response.shape[1]), exact @ error[valid])
    return np.where(valid, error, response @ kicks)


def test_masked_bpms_count_as_the_valid_ones_let_expect():
    """Nine correctors move every valid BPM as they like, so nothing is taken off the change."""
    response = make_response()
    error = 1e-4 * np.random.default_rng(5).normal(size=12)
    policy = SvdPolicy(response, SvdSettings(gain=1.0))
    valid = np.ones(12, dtype=bool)
    valid[[2, 7]] = False
    error[~valid] = np.nan
    change, _ = act(policy, error, valid)
    expected = tikhonov(response, filled(response, error, valid), LAMBDA)
    np.testing.assert_allclose(change, expected, rtol=1e-8)


def test_many_masks_each_get_their_own_answer():
    response = make_response()
    policy = SvdPolicy(response, SvdSettings(gain=1.0))
    error = 1e-4 * np.ones(12)
    for _ in range(2):  # the second round meets masks that were dropped and masks that were kept
        for masked in range(12):
            valid = np.arange(12) != masked
            change, _ = act(policy, error, valid)
            expected = tikhonov(response, filled(response, error, valid), LAMBDA)
            np.testing.assert_allclose(change, expected, rtol=1e-8)


@pytest.mark.parametrize("masked", [1, 5, 8])
def test_the_change_is_the_least_that_does_it_where_bpms_are_fewer_than_correctors(masked):
    response = make_response(3, 12, 12)
    policy = SvdPolicy(response, SvdSettings(gain=1.0, regularisation=0.0))
    error = response @ np.random.default_rng(2).normal(size=12)
    valid = np.arange(12) >= masked
    change, _ = act(policy, error, valid)
    np.testing.assert_allclose(change, np.linalg.pinv(response[valid]) @ -error[valid], rtol=1e-6)


def test_with_no_valid_bpm_nothing_is_changed():
    policy = SvdPolicy(make_response(), SvdSettings())
    change, _ = act(policy, np.full(12, np.nan), np.zeros(12, dtype=bool))
    np.testing.assert_array_equal(change, np.zeros(9))


def run_ramp(policy, ramp, ticks=400):
    """Let the setpoints accumulate against an error that grows by `ramp` per tick."""
    error, state = np.zeros(policy.response.shape[0]), policy.initial_state()
    for _ in range(ticks):
        change, state = policy.act(error, all_valid(policy), state)
        error = error + policy.response @ change + ramp
    return error


def test_the_integral_takes_a_constant_ramp_away():
    response = make_response(3, 9, 9)
    ramp = 1e-6 * response @ np.ones(9) / np.linalg.norm(response @ np.ones(9))
    proportional = SvdSettings(gain=0.5, regularisation=0.0)
    integral = proportional.model_copy(update={"integral_gain": 0.1})
    left_by_p = run_ramp(SvdPolicy(response, proportional), ramp)
    left_by_pi = run_ramp(SvdPolicy(response, integral), ramp)
    np.testing.assert_allclose(left_by_p, ramp / 0.5, rtol=1e-6)  # the closed form of a P loop
    assert np.linalg.norm(left_by_pi) < 1e-6 * np.linalg.norm(left_by_p)


def test_the_integral_does_not_wind_up():
    policy = SvdPolicy(
        make_response(), SvdSettings(integral_gain=0.1, integral_limit=1e-3, regularisation=0.0)
    )
    state, error = policy.initial_state(), policy.response @ np.ones(9)
    for _ in range(1000):
        _, state = policy.act(error, all_valid(policy), state)
    assert np.sqrt(np.mean(state.integral**2)) == pytest.approx(1e-3)


def test_the_state_handed_in_is_not_changed():
    policy = SvdPolicy(make_response(), SvdSettings(integral_gain=0.1))
    state = policy.initial_state()
    _, after = act(policy, 1e-4 * np.ones(12), state=state)
    assert not state.integral.any()
    assert after.integral.any()


def test_the_cautious_law_is_its_closed_form():
    response = make_response()
    root = 1e-4 * np.random.default_rng(2).normal(size=(9, 9))
    covariance = root @ root.T
    policy = SvdPolicy(response, SvdSettings(gain=0.8), covariance=covariance)
    expected = 0.8 * np.linalg.solve(
        response.T @ response + LAMBDA**2 * np.eye(9) + 12 * covariance, response.T
    )
    np.testing.assert_allclose(policy.gain_matrix, expected, rtol=1e-8)


def test_the_cautious_law_minimises_the_expected_square_of_the_next_orbit():
    """Over drawn response matrices no scaled or disturbed change does better on average."""
    rng = np.random.default_rng(7)
    response = make_response(1, 12, 5)
    covariance = np.diag(np.array([1.0, 2.0, 4.0, 8.0, 16.0]) * 1e-8)
    policy = SvdPolicy(response, SvdSettings(gain=1.0, regularisation=0.0), covariance=covariance)
    error = 1e-4 * rng.normal(size=12)
    drawn = response + rng.normal(size=(40_000, 12, 5)) * np.sqrt(np.diag(covariance))
    change, _ = act(policy, error)
    best = np.mean((error + drawn @ change) ** 2)
    naive = -np.linalg.pinv(response) @ error
    assert best < np.mean((error + drawn @ naive) ** 2)
    for factor in (0.9, 1.1):
        assert best < np.mean((error + drawn @ (factor * change)) ** 2)


def test_no_doubt_is_the_plain_law():
    response, chosen = make_response(), SvdSettings(singular_values=5)
    plain = SvdPolicy(response, chosen)
    cautious = SvdPolicy(response, chosen, covariance=np.zeros((9, 9)))
    np.testing.assert_allclose(cautious.gain_matrix, plain.gain_matrix, rtol=1e-9, atol=1e-9)


def test_its_name_follows_its_content():
    response = make_response()
    name = SvdPolicy(response, SvdSettings()).policy_id
    assert name.startswith("svd-")
    assert name == SvdPolicy(response.copy(order="F"), SvdSettings()).policy_id
    others = [
        SvdPolicy(1.01 * response, SvdSettings()),
        SvdPolicy(response, SvdSettings(gain=0.4)),
        SvdPolicy(response, SvdSettings(), covariance=np.eye(9)),
    ]
    assert len({name, *(other.policy_id for other in others)}) == 4
    assert SvdPolicy(response, SvdSettings(), policy_id="golden").policy_id == "golden"


def test_it_is_deaf_to_later_writes_into_the_response():
    response = make_response()
    policy = SvdPolicy(response, SvdSettings())
    response[:] = 0.0
    assert policy.response.any()
    with pytest.raises(ValueError, match="read-only"):
        policy.response[0, 0] = 1.0


@pytest.mark.parametrize(
    ("response", "words"),
    [
        (np.zeros(4), "shape"),
        (np.zeros((0, 4)), "shape"),
        (np.zeros((4, 4)), "all zeros"),
        (np.array([[1.0, np.nan], [0.0, 1.0]]), r"row 0 \(BPM\), column 1"),
        (np.ones((2, 2), dtype=complex), "complex"),
    ],
)
def test_a_bad_response_is_refused(response, words):
    with pytest.raises(RingError, match=words):
        SvdPolicy(response, SvdSettings())


@pytest.mark.parametrize(
    ("covariance", "words"),
    [
        (np.eye(8), r"\(9, 9\)"),
        (np.full((9, 9), np.inf), "not finite"),
        (-np.eye(9), "no covariance"),
        (np.triu(np.ones((9, 9))), "no covariance"),
    ],
)
def test_a_bad_covariance_is_refused(covariance, words):
    with pytest.raises(RingError, match=words):
        SvdPolicy(make_response(), SvdSettings(), covariance=covariance)


def test_more_singular_values_than_there_are_is_refused():
    with pytest.raises(ConfigError, match="has only 9"):
        SvdPolicy(make_response(), SvdSettings(singular_values=10))
