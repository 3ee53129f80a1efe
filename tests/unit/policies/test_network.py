"""The network policy against its formula, and the embedded law against the law itself."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orbitfb.core.errors import ConfigError, RingError
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.embedding import embed, reembed
from orbitfb.policies.modal import ModalPolicy, ModalSettings
from orbitfb.policies.network import NetworkPolicy, NetworkSettings, hidden_width, network_sizes

SCALE = 250e-6
AMPLITUDES = (0.05e-6, 0.1e-6, 0.2e-6, 1e-6, 10e-6, 100e-6, 250e-6, 1e-3)


def make_response(seed=0, bpms=12, correctors=9):
    return 1e-3 * np.random.default_rng(seed).normal(size=(bpms, correctors))


def make_weights(seed=0, bpms=12, correctors=9):
    rng = np.random.default_rng(seed)
    sizes = network_sizes(bpms, correctors)
    return [
        rng.normal(size=(outputs, inputs)).astype(np.float32) / np.float32(inputs**0.5)
        for inputs, outputs in pairwise(sizes)
    ]


def make_policy(seed=0, **chosen):
    return NetworkPolicy(make_weights(seed), make_response(seed), **chosen)


def valid_all(policy):
    return np.ones(len(policy.response), dtype=bool)


def by_formula(weights, error):
    x = error / SCALE
    for weight in weights[:-1]:
        x = np.tanh(weight.astype(float) @ x)
    return weights[-1].astype(float) @ x


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 999), st.sampled_from(AMPLITUDES))
def test_it_is_its_formula_at_every_amplitude(seed, amplitude):
    policy = make_policy(seed)
    error = amplitude * np.random.default_rng(seed + 1).normal(size=12)
    change, state = policy.act(error, valid_all(policy), policy.initial_state())
    expected = by_formula(make_weights(seed), error)
    np.testing.assert_allclose(change, expected, atol=3e-6 * np.linalg.norm(expected))
    assert state is None
    assert change.dtype == np.float64


def test_nothing_in_nothing_out():
    policy = make_policy()
    assert not policy.act(np.zeros(12), valid_all(policy), None)[0].any()
    assert not policy.act(np.full(12, np.nan), np.zeros(12, dtype=bool), None)[0].any()


def test_many_orbits_at_once_are_the_same_as_one_by_one():
    policy = make_policy()
    errors = 1e-5 * np.random.default_rng(3).normal(size=(4, 5, 12))
    together = policy.changes(errors)
    assert together.shape == (4, 5, 9)
    alone = policy.act(errors[2, 3], valid_all(policy), None)[0]
    np.testing.assert_allclose(together[2, 3], alone, atol=1e-6 * np.linalg.norm(alone))


def test_the_gain_matrix_is_the_slope_at_zero():
    policy = make_policy()
    step = 1e-9
    slopes = np.stack([by_formula(make_weights(), step * unit) / step for unit in np.eye(12)], 1)
    np.testing.assert_allclose(policy.gain_matrix, -slopes, rtol=1e-4, atol=1e-5)


def test_the_width_follows_the_ring():
    assert network_sizes(180, 180) == (180, 512, 512, 512, 180)
    assert hidden_width(360) == 1024
    assert all(hidden_width(n) >= 2 * n for n in range(1, 400))
    law = ModalPolicy(np.eye(180), ModalSettings())
    assert embed(law).parameters == 180 * 512 + 512 * 512 + 512 * 512 + 512 * 180 == 708_608


def test_a_diagonal_layer_is_only_a_short_cut():
    weights = make_weights()
    weights[1] = np.diag(np.linspace(-1, 1, len(weights[1]))).astype(np.float32)
    policy = NetworkPolicy(weights, make_response())
    error = 1e-4 * np.random.default_rng(1).normal(size=12)
    expected = by_formula(weights, error)
    for change in (policy.act(error, valid_all(policy), None)[0], policy.changes(error)):
        np.testing.assert_allclose(change, expected, atol=3e-6 * np.linalg.norm(expected))


def test_masked_bpms_are_filled_in():
    """On an orbit that a corrector makes, a masked BPM is as good as known."""
    rng = np.random.default_rng(2)
    matrix = 1e-3 * rng.normal(size=(12, 4))
    law = ModalPolicy(matrix, ModalSettings(threshold=None), gains=1.0)
    policy = embed(law)
    error = matrix @ (0.05 * rng.normal(size=4))
    valid = np.arange(12) != 5
    whole = policy.act(error, valid_all(policy), None)[0]
    masked = policy.act(np.where(valid, error, np.nan), valid, None)[0]
    np.testing.assert_allclose(masked, whole, atol=2e-2 * np.linalg.norm(whole))


def test_its_name_follows_its_content():
    name = make_policy().policy_id
    assert name.startswith("network-")
    assert name == make_policy().policy_id
    others = [
        make_policy(1),
        make_policy(settings=NetworkSettings(input_scale=1e-4)),
        NetworkPolicy(make_weights(), 2 * make_response()),
    ]
    assert len({name, *(other.policy_id for other in others)}) == 4
    assert make_policy(policy_id="golden").policy_id == "golden"


def test_it_is_deaf_to_later_writes():
    weights = make_weights()
    policy = NetworkPolicy(weights, make_response())
    for weight in weights:
        weight[:] = 0.0
    assert policy.act(np.full(12, 1e-4), valid_all(policy), None)[0].any()
    with pytest.raises(ValueError, match="read-only"):
        policy.weights[0][0] = 1.0


def test_weights_that_make_no_network_are_refused():
    weights = make_weights()
    with pytest.raises(ConfigError, match="4 matrices, not 3"):
        NetworkPolicy(weights[:3], make_response())
    with pytest.raises(RingError, match="make no network"):
        NetworkPolicy(weights, make_response(correctors=8))
    with pytest.raises(RingError, match="make no network"):
        NetworkPolicy([weights[0], weights[1][:, :-1], *weights[2:]], make_response())
    weights[2][0, 0] = np.nan
    with pytest.raises(RingError, match="matrix 3"):
        NetworkPolicy(weights, make_response())


@pytest.fixture(scope="module")
def ring_response():
    return response(Ring.load(), "x")


def some_law(matrix, **chosen):
    """Thresholds of every sort: infinite, zero, and in between."""
    n = len(matrix)
    rng = np.random.default_rng(7)
    gains = rng.uniform(0.02, 1.0, n)
    thresholds = rng.uniform(0.5e-6, 2e-6, n)
    thresholds[::5], thresholds[1::5] = np.inf, 0.0
    return ModalPolicy(
        matrix, ModalSettings(), **({"gains": gains, "thresholds": thresholds} | chosen)
    )


@pytest.mark.parametrize("amplitude", AMPLITUDES)
def test_an_embedded_law_is_the_law(ring_response, amplitude):
    """Per change within 5e-5 (the floor) and 2e-6 (from 1 µm on) of the law's.

    The orbit that is left is within 1e-4 of the orbit before: single precision times the
    condition number.
    """
    errors = amplitude * np.random.default_rng(0).normal(size=(40, 180))
    two_scales = ModalSettings(regularisation=2e-5, near_caution=0.05)
    for law in (
        some_law(ring_response),
        ModalPolicy(ring_response, ModalSettings()),
        ModalPolicy(ring_response, two_scales),
    ):
        policy = embed(law)
        difference = policy.changes(errors) - law.changes(errors)
        tolerance = 5e-5 if amplitude < 1e-6 else 2e-6
        assert np.linalg.norm(difference) < tolerance * np.linalg.norm(law.changes(errors))
        left = difference @ ring_response.T
        assert np.linalg.norm(left) < 1e-4 * np.linalg.norm(errors)


def test_an_embedded_law_has_the_slope_of_the_law(ring_response):
    law = some_law(ring_response)
    difference = embed(law).gain_matrix - law.gain_matrix
    assert np.max(np.abs(difference)) < 2e-5 * np.max(np.abs(law.gain_matrix))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 99), st.integers(2, 12), st.integers(2, 12), st.floats(-8.0, -3.0))
def test_laws_of_any_shape_can_be_embedded(seed, bpms, correctors, decade):
    law = some_law(make_response(seed, bpms, correctors), covariance=1e-8 * np.eye(correctors))
    error = 10**decade * np.random.default_rng(seed).normal(size=bpms)
    expected = law.changes(error)
    difference = embed(law).changes(error) - expected
    assert np.linalg.norm(difference) < 1e-4 * np.linalg.norm(error) * np.linalg.norm(law.inverse)
    assert np.linalg.norm(difference) < 2e-4 * np.linalg.norm(expected)


def test_a_larger_linear_range_bends_as_stated(ring_response):
    law = ModalPolicy(ring_response, ModalSettings(threshold=None), gains=1.0)
    errors = 250e-6 * np.random.default_rng(0).normal(size=(20, 180))
    expected = law.changes(errors)
    for linear_range, bend in ((0.02, 1.5e-3), (5e-3, 1e-4)):
        difference = embed(law, linear_range=linear_range).changes(errors) - expected
        relative = np.linalg.norm(difference) / np.linalg.norm(expected)
        assert relative == pytest.approx(bend, rel=0.2)


def test_a_new_response_in_the_same_modes_changes_the_last_matrix_only(ring_response):
    law = some_law(ring_response)
    old = embed(law)
    rng = np.random.default_rng(1)
    moved = ring_response * (1 + 0.05 * rng.normal(size=ring_response.shape))
    new_law = some_law(
        moved, modes=law.modes, gains=0.5 * law.gains, covariance=1e-10 * np.eye(180)
    )
    new = reembed(old, new_law)
    for kept, shared in zip(old.weights[:-1], new.weights[:-1], strict=True):
        assert kept is shared
    assert new.policy_id == embed(new_law).policy_id != old.policy_id
    np.testing.assert_array_equal(new.weights[-1], embed(new_law).weights[-1])
    np.testing.assert_array_equal(new.response, moved)


def test_other_modes_or_thresholds_are_not_reembedded():
    law = some_law(make_response())
    policy = embed(law)
    with pytest.raises(ConfigError, match="embed it anew"):
        reembed(policy, some_law(make_response(1)))
    with pytest.raises(ConfigError, match="embed it anew"):
        reembed(policy, some_law(make_response(), thresholds=1e-6))


@pytest.mark.parametrize("linear_range", [0.0, 0.5, float("nan")])
def test_a_linear_range_that_is_none_is_refused(linear_range):
    with pytest.raises(ConfigError, match="linear_range"):
        embed(some_law(make_response()), linear_range=linear_range)


def test_units_that_carry_nothing_are_only_left_out():
    weights = make_weights()
    width = len(weights[1])
    rng = np.random.default_rng(4)
    for number in (1, 2):
        weights[number] = np.diag(rng.choice([0.0, 0.5, 1.0], width)).astype(np.float32)
    weights[0][3:9] = 0.0
    weights[3][:, 20:] = 0.0
    policy = NetworkPolicy(weights, make_response())
    error = 1e-4 * rng.normal(size=12)
    expected = by_formula(weights, error)
    assert expected.any()
    for change in (policy.act(error, valid_all(policy), None)[0], policy.changes(error)):
        np.testing.assert_allclose(change, expected, atol=3e-6 * np.linalg.norm(expected))


@pytest.mark.parametrize("diagonal", [False, True])
def test_widths_need_not_be_equal(diagonal):
    rng = np.random.default_rng(0)
    shapes = [(20, 12), (31, 20), (17, 31), (9, 17)]
    weights = [rng.normal(size=shape).astype(np.float32) / 5 for shape in shapes]
    if diagonal:
        weights[1], weights[2] = (np.eye(*shape, dtype=np.float32) for shape in shapes[1:3])
    error = 1e-5 * rng.normal(size=12)
    policy = NetworkPolicy(weights, make_response())
    expected = by_formula(weights, error)
    np.testing.assert_allclose(
        policy.changes(error), expected, atol=3e-6 * np.linalg.norm(expected)
    )
