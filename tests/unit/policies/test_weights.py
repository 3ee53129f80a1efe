"""Weights of the BPMs in the linear law, against least squares solved another way."""

import numpy as np
import pytest
from pydantic import ValidationError

from orbitfb.core.errors import ConfigError
from orbitfb.policies.masking import MaskedPolicy
from orbitfb.policies.svd import SvdPolicy, SvdSettings

N, M = 12, 7
RANDOM = np.random.default_rng(4)
RESPONSE = 1e-3 * RANDOM.normal(size=(N, M))
ERROR = 1e-5 * RANDOM.normal(size=N)
WEIGHTS = tuple(RANDOM.uniform(0.2, 3.0, N).tolist())


def law(weights=WEIGHTS, **chosen):
    chosen = {"gain": 1.0, "regularisation": 2e-4} | chosen
    return SvdPolicy(RESPONSE, SvdSettings(bpm_weights=weights, **chosen))


def act(policy, valid=None):
    valid = np.ones(N, dtype=bool) if valid is None else valid
    return policy.act(ERROR, valid, policy.initial_state())[0]


def test_it_minimises_the_weighted_squares():
    scale = np.array(WEIGHTS) / np.sqrt(np.mean(np.square(WEIGHTS)))
    rows = np.vstack([scale[:, None] * RESPONSE, 2e-4 * np.eye(M)])
    wanted = np.linalg.lstsq(rows, np.concatenate([-scale * ERROR, np.zeros(M)]))[0]
    np.testing.assert_allclose(act(law()), wanted, rtol=1e-9)


def test_only_their_ratios_count_and_equal_ones_are_none():
    twice = law(tuple(2 * weight for weight in WEIGHTS))
    np.testing.assert_allclose(act(twice), act(law()), rtol=1e-12)
    np.testing.assert_allclose(act(law((3.0,) * N)), act(law(())), rtol=1e-9)
    assert law(()).policy_id != law().policy_id
    assert law(()).bpm_weights is None


def test_a_bpm_of_weight_0_has_no_say_and_one_of_much_weight_is_obeyed():
    silent = (0.0, *(1.0,) * (N - 1))
    part = np.sqrt(N / (N - 1))  # the others weigh so much more, and lambda less
    alone = SvdPolicy(RESPONSE[1:], SvdSettings(gain=1.0, regularisation=2e-4 / part))
    wanted, _ = alone.act(ERROR[1:], np.ones(N - 1, dtype=bool), alone.initial_state())
    np.testing.assert_allclose(act(law(silent)), wanted, rtol=1e-9)
    heavy = act(law((100.0, *(1.0,) * (N - 1)), regularisation=0.0))
    rest = ERROR + RESPONSE @ heavy
    assert abs(rest[0]) < 1e-3 * np.abs(rest).max()


def test_a_masked_corrector_is_as_if_it_were_not_there():
    movable = np.arange(M) != 3
    masked = MaskedPolicy(law(), RESPONSE, movable)
    settings = SvdSettings(gain=1.0, regularisation=2e-4, bpm_weights=WEIGHTS)
    without = SvdPolicy(RESPONSE[:, movable], settings)
    np.testing.assert_allclose(act(masked)[movable], act(without), rtol=1e-8)


@pytest.mark.parametrize("weights", [(1.0,) * (N - 1), (0.0,) * N])
def test_weights_that_do_not_fit_are_refused(weights):
    with pytest.raises(ConfigError, match="give one for each of 12 BPMs"):
        law(weights)
    for bad in (-1.0, 101.0, float("nan")):
        with pytest.raises(ValidationError):
            SvdSettings(bpm_weights=(bad,) * N)
