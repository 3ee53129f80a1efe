"""Masks: gaps filled as a Gaussian process fills them, changes handed on exactly."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orbitfb.core.errors import ConfigError, RingError
from orbitfb.core.signals import Channels
from orbitfb.policies.infill import Infill
from orbitfb.policies.masking import MaskedPolicy, MaskSettings, mask_of
from orbitfb.policies.modal import ModalPolicy, ModalSettings
from orbitfb.policies.svd import SvdPolicy, SvdSettings


def make_response(seed=0, bpms=12, correctors=9):
    return 1e-3 * np.random.default_rng(seed).normal(size=(bpms, correctors))


def act(policy, error, valid=None):
    valid = np.ones(len(error), dtype=bool) if valid is None else valid
    return policy.act(error, valid, policy.initial_state())[0]


def test_an_orbit_that_correctors_can_make_is_filled_in_exactly():
    response = make_response(0, 12, 5)
    orbit = response @ np.array([0.1, -0.2, 0.05, 0.3, -0.1])
    valid = np.ones(12, dtype=bool)
    valid[[0, 7, 11]] = False
    filled = Infill(response, floor=1e-12).fill(np.where(valid, orbit, np.nan), valid)
    np.testing.assert_allclose(filled, orbit, rtol=1e-6)


def test_what_is_filled_in_is_the_best_linear_guess():
    """Over orbits drawn from the prior no other weights do better on average."""
    response, rng = make_response(1, 6, 4), np.random.default_rng(3)
    floor = 0.05
    white = np.sqrt(floor * np.sum(response**2, axis=1))
    orbits = rng.normal(size=(40_000, 4)) @ response.T + white * rng.normal(size=(40_000, 6))
    valid = np.array([True, True, False, True, True, True])
    weights = np.array(
        [Infill(response, floor).fill(unit, valid)[2] for unit in np.eye(6)]
    )  # linear in the orbit, so that its answers to units are its weights
    regression = np.linalg.lstsq(orbits[:, valid], orbits[:, 2], rcond=None)[0]
    np.testing.assert_allclose(weights[valid], regression, atol=0.03)
    assert weights[2] == 0.0


def test_a_bpm_that_nothing_moves_says_nothing_of_the_masked_ones():
    response = make_response(1, 6, 4)
    response[1] = 0.0
    error, valid = 1e-4 * np.arange(1.0, 7.0), np.arange(6) != 2
    filled = Infill(response).fill(error, valid)
    alone = Infill(np.delete(response, 1, axis=0)).fill(np.delete(error, 1), np.delete(valid, 1))
    np.testing.assert_allclose(np.delete(filled, 1), alone, rtol=1e-9)


def test_with_nothing_valid_nothing_is_expected():
    filled = Infill(make_response()).fill(np.full(12, np.nan), np.zeros(12, dtype=bool))
    np.testing.assert_array_equal(filled, np.zeros(12))


@pytest.mark.parametrize("bpms", [0, 3, 8, 11])
def test_the_least_change_moves_the_valid_bpms_alike(bpms):
    """Against the pseudo-inverse; two of nine correctors are alike, so that nothing tells them."""
    response = make_response(2)
    response[:, 8] = response[:, 7]
    valid = np.arange(12) < bpms
    change = np.random.default_rng(4).normal(size=9)
    known = response[valid]
    expected = np.linalg.pinv(known) @ known @ change
    if bpms > 9:
        expected = change  # no fewer BPMs than correctors: it is left alone
    np.testing.assert_allclose(Infill(response).least(change, valid), expected, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(
    st.integers(0, 999),
    st.integers(2, 10),
    st.integers(2, 10),
    st.sampled_from([1e-5, 7e-5, 1e-3]),
    st.booleans(),
    st.data(),
)
def test_a_linear_law_under_a_mask_is_the_law_without_those_columns(
    seed, bpms, correctors, strength, cautious, data
):
    movable = np.array(
        data.draw(st.lists(st.booleans(), min_size=correctors, max_size=correctors).filter(any))
    )
    response = make_response(seed, bpms, correctors)
    root = 1e-4 * np.random.default_rng(seed + 1).normal(size=(correctors, correctors))
    covariance = root @ root.T if cautious else None
    among = covariance[np.ix_(movable, movable)] if covariance is not None else None
    chosen = SvdSettings(gain=0.7, regularisation=strength)
    masked = MaskedPolicy(SvdPolicy(response, chosen, covariance=covariance), response, movable)
    without = SvdPolicy(response[:, movable], chosen, covariance=among)
    error = 1e-4 * np.random.default_rng(seed + 2).normal(size=bpms)
    change = act(masked, error)
    expected = act(without, error)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(change[movable], expected, rtol=1e-5, atol=1e-7 * scale)
    np.testing.assert_array_equal(change[~movable], 0.0)
    np.testing.assert_array_equal(masked.gain_matrix[~movable], 0.0)


def test_a_law_that_is_not_linear_hands_its_effect_on():
    response = make_response(0, 12, 9)
    inside = ModalPolicy(response, ModalSettings())
    movable = np.arange(9) != 4
    error = 1e-5 * response @ np.ones(9)
    masked = MaskedPolicy(inside, response, movable)
    asked, done = response @ act(inside, error), response @ act(masked, error)
    best = np.linalg.lstsq(response[:, movable], asked, rcond=None)[0]
    np.testing.assert_allclose(done, response[:, movable] @ best, rtol=1e-6, atol=1e-15)


def test_masks_of_bpms_and_correctors_go_together():
    """The valid BPMs are moved as far as the free correctors can move them like the law inside."""
    response, movable = make_response(), np.arange(9) > 1
    inside = SvdPolicy(response, SvdSettings(gain=1.0, regularisation=0.0))
    valid = np.arange(12) != 3
    error = np.where(valid, 1e-4 * np.random.default_rng(5).normal(size=12), np.nan)
    change = act(MaskedPolicy(inside, response, movable), error, valid)
    asked, free = response[valid] @ act(inside, error, valid), response[valid][:, movable]
    assert not change[~movable].any()
    np.testing.assert_allclose(change[movable], np.linalg.lstsq(free, asked)[0], rtol=1e-6)


def test_an_ill_posed_hand_over_has_the_smallest_answer():
    """Two equal correctors take a third one's share half each, though none is determined."""
    column = make_response(0, 6, 1)
    response = np.hstack([column, column, column])
    inside = SvdPolicy(response, SvdSettings(gain=1.0, regularisation=0.0))
    masked = MaskedPolicy(inside, response, np.array([True, True, False]))
    np.testing.assert_allclose(act(masked, column[:, 0]), [-0.5, -0.5, 0.0], atol=1e-9)


@pytest.mark.parametrize("movable", [np.zeros(9, dtype=bool), np.ones(8, dtype=bool)])
def test_a_mask_that_does_not_fit_is_refused(movable):
    response = make_response()
    with pytest.raises(RingError, match="leave at least one"):
        MaskedPolicy(SvdPolicy(response, SvdSettings()), response, movable)


def channels(planes="x"):
    bpms, correctors = ("PH1A_C30", "PH2A_C30", "PM1A_C30"), ("CH1A_C30", "CH2A_C30")
    k = len(planes)
    return Channels(planes, bpms * k, correctors * k, bpms * k, correctors * k, correctors * k)


def test_names_become_masks():
    chosen = MaskSettings(bpms=("PH2A_C30",), correctors=("CH1A_C30",))
    valid, movable = mask_of(channels(), chosen)
    np.testing.assert_array_equal(valid, [True, False, True])
    np.testing.assert_array_equal(movable, [False, True])


def test_a_name_masks_both_planes_and_one_with_its_plane_only_that():
    chosen = MaskSettings(bpms=("PH2A_C30",), correctors=("CH1A_C30:y",))
    valid, movable = mask_of(channels("xy"), chosen)
    np.testing.assert_array_equal(valid, [True, False, True] * 2)
    np.testing.assert_array_equal(movable, [True, True, False, True])


@pytest.mark.parametrize(
    ("chosen", "words"),
    [
        (
            {"bpms": ("PH2A_C3O", "zzz")},
            r"masks.bpms names 2 .* planes x: 'PH2A_C3O' \(did you mean PH2A_C30.*'zzz'; use the",
        ),
        ({"correctors": ("PH2A_C30",)}, "masks.correctors names 1"),
        ({"bpms": ("PH2A_C30:y",)}, r"did you mean PH2A_C30:x"),
        ({"correctors": ("CH1A_C30", "CH2A_C30")}, "masks.correctors masks all 2"),
    ],
)
def test_a_name_that_the_ring_does_not_have_is_refused(chosen, words):
    with pytest.raises(ConfigError, match=words):
        mask_of(channels(), MaskSettings(**chosen))
