"""The growth of the loop that a policy makes, against the loop itself."""

import numpy as np
import pytest
from policy_examples import BPMS, CORRECTORS, make_response
from store_examples import make_policy, ring

from orbitfb.policies.masking import MaskedPolicy
from orbitfb.policies.network import NetworkPolicy, NetworkSettings
from orbitfb.policies.stability import HIGHEST, MARGIN, growth_of, is_unstable, warning_of
from orbitfb.policies.store.directory import PolicyStore
from orbitfb.policies.svd import SvdPolicy, SvdSettings

WIDE = {"integral_limit": 1e150, "derivative_limit": 1e150}


def lived(policy, ticks=300):
    """The growth per tick of an orbit that correctors made, from highest to highest."""
    valid, state = np.ones(BPMS, dtype=bool), policy.initial_state()
    orbit = policy.response @ np.random.default_rng(1).standard_normal(CORRECTORS)
    kept = []
    for _ in range(ticks):
        change, state = policy.act(orbit, valid, state)
        orbit = orbit + policy.response @ change
        kept.append(np.linalg.norm(policy.gain_matrix @ orbit))  # not what no corrector reaches
    third = ticks // 3
    return (max(kept[-third:]) / max(kept[third:-third])) ** (1.0 / third)


@pytest.mark.parametrize(
    "chosen",
    [
        {"gain": 0.05},
        {"gain": 1.8},
        {"gain": 0.2, "integral_gain": 0.05},
        {"gain": 1.5, "integral_gain": 1.0},
        {"gain": 0.2, "derivative_gain": 0.3, "derivative_filter": 0.5},
        {"gain": 1.0, "integral_gain": 0.3, "derivative_gain": 0.9},
    ],
)
def test_growth_is_that_of_the_loop(chosen):
    policy = SvdPolicy(make_response(), SvdSettings(regularisation=1e-4, **chosen, **WIDE))
    assert growth_of(policy) == pytest.approx(lived(policy), rel=1e-2)


def test_a_law_on_the_wrong_response_is_seen_through_its_slope():
    right = SvdPolicy(make_response(), SvdSettings(gain=0.5))
    weights = [np.zeros(shape, dtype=np.float32) for shape in ((4, BPMS), (4, 4), (4, 4))]
    last = np.zeros((CORRECTORS, 4), dtype=np.float32)
    for weight in weights:
        np.fill_diagonal(weight, 1.0)
    last[:4] = np.eye(4)
    network = NetworkPolicy([*weights, last], right.response, NetworkSettings())
    slope = np.eye(CORRECTORS) - network.gain_matrix @ right.response
    expected = np.abs(np.linalg.eigvals(slope)).max()
    assert growth_of(network) == pytest.approx(expected, rel=1e-6)
    assert expected > HIGHEST and is_unstable(warning_of(network))
    assert warning_of(right) is None


def test_a_masked_corrector_counts():
    """A law that uses a corrector which does not move is not the law that was looked at."""
    response = make_response()
    policy = MaskedPolicy(
        SvdPolicy(response, SvdSettings(gain=0.4)), response, np.arange(CORRECTORS) != 3
    )
    left = policy.gain_matrix @ response
    expected = np.abs(1.0 - np.linalg.eigvals(left)).max()
    assert growth_of(policy) == pytest.approx(expected)


@pytest.mark.parametrize("modes", [3, CORRECTORS])
def test_modes_that_a_law_leaves_alone_are_not_unstable(modes):
    policy = SvdPolicy(make_response(), SvdSettings(singular_values=modes))
    assert warning_of(policy) is None


def test_the_card_of_an_unstable_policy_says_so(tmp_path):
    store = PolicyStore(tmp_path)
    bad = SvdPolicy(np.eye(4), SvdSettings(gain=1.8, integral_gain=1.0))
    channels = ring(4, 4)
    card = store.card(store.save(bad, channels))
    assert card.growth == pytest.approx(growth_of(bad)) and card.growth > 1.2
    assert card.warning is not None and card.warning.startswith("unstable: ")
    good = store.card(store.save(make_policy(), ring()))
    assert good.warning is None and good.growth < 1.0


@pytest.mark.parametrize("gain", [1.0, 1.8, 1.89])
def test_a_gain_with_room_for_a_larger_response_is_not_warned_of(gain):
    policy = SvdPolicy(make_response(), SvdSettings(gain=gain, regularisation=0.0))
    assert warning_of(policy) is None
    on_the_ring = SvdPolicy((1 + MARGIN) * policy.response, policy.settings)
    on_the_ring.gain_matrix = policy.gain_matrix
    assert growth_of(policy, MARGIN) == pytest.approx(growth_of(on_the_ring))


@pytest.mark.parametrize("gain", [1.92, 1.95, 1.99])
def test_a_gain_near_two_is_warned_of_but_may_act(gain):
    warning = warning_of(SvdPolicy(make_response(), SvdSettings(gain=gain, regularisation=0.0)))
    assert warning is not None and warning.startswith(
        "near its limit: on a response that is larger"
    )
    assert not is_unstable(warning)


def test_a_gain_of_two_is_unstable_and_refused():
    policy = SvdPolicy(make_response(), SvdSettings(regularisation=0.0))
    policy.gain_matrix = 4.0 * policy.gain_matrix
    assert growth_of(policy) == pytest.approx(1.0)
    assert is_unstable(warning_of(policy))
    with pytest.raises(ValueError, match="less than 2"):
        SvdSettings(gain=2.0)
