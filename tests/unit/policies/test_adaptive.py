"""The law that learns while it acts: what it learns, what it keeps, what it leaves alone."""

import numpy as np
import pytest
from policy_examples import BPMS, CORRECTORS, make_response

from orbitfb.core.ports import inform
from orbitfb.policies.adaptive import AdaptivePolicy
from orbitfb.policies.adaptive_settings import AdaptiveSettings
from orbitfb.policies.masking import MaskedPolicy
from orbitfb.policies.store.kinds import kind_of
from orbitfb.safety.limits import LimitSettings

NOISE = 0.2e-6
LIMITS = LimitSettings()
EVERY = np.ones(BPMS, dtype=bool)


def wrong_response(seed=5, relative=0.3):
    """A response whose weakest modes are the wrong way round."""
    left, sizes, right = np.linalg.svd(make_response(), full_matrices=False)
    sizes = sizes * np.where(np.arange(CORRECTORS) < CORRECTORS - 2, 1.0, -1.0)
    rng = np.random.default_rng(seed)
    return (left * sizes) @ right * (1.0 + relative * rng.normal(size=(BPMS, CORRECTORS)))


def settings(**tracking):
    chosen = {
        "prior_entry": 2e-3,
        "prior_relative": 0.0,
        "drift_entry": 0.0,
        "creep": 0.0,
        "ground": 1e-6,
    }
    return AdaptiveSettings.model_validate({"tracking": chosen | tracking})


def run(policy, truth, ticks=400, seed=1, told=True, valid=EVERY, scale=1.0):
    """Close the loop on a ring that is kicked at every tick; give the true orbits [m]."""
    rng = np.random.default_rng(seed)
    state, orbit, orbits = policy.initial_state(), np.zeros(BPMS), []
    for _ in range(ticks):
        reading = orbit + NOISE * rng.normal(size=BPMS)
        reading[~valid] = np.nan
        change, state = policy.act(reading, valid, state)
        change = scale * change
        if told:
            state = inform(policy, reading, valid, change, state)
        orbit = orbit + truth @ (change + 4e-5 * rng.normal(size=CORRECTORS))
        orbits.append(orbit)
    return np.array(orbits)


def off(response, truth):
    return np.linalg.norm(response - truth) / np.linalg.norm(truth)


def test_it_finds_the_response_while_it_corrects_with_it():
    truth, first = make_response(), wrong_response()
    policy = AdaptivePolicy(first, settings())
    orbits = run(policy, truth)
    deaf = run(AdaptivePolicy(first, settings()), truth, told=False)
    left, _, right = np.linalg.svd(truth, full_matrices=False)
    weakest = left[:, -2:], right[-2:]
    before, after = (np.diag(weakest[0].T @ r @ weakest[1].T) for r in (first, policy.response))
    assert np.all(before < 0.0) and np.all(after > 0.0)
    late = np.sqrt(np.mean(orbits[200:] ** 2))
    assert late < 0.2 * np.sqrt(np.mean(deaf[200:] ** 2))


def test_its_interval_holds_the_truth():
    truth = make_response()
    policy = AdaptivePolicy(wrong_response(relative=0.0), settings())
    run(policy, truth)
    errors = policy.initial_state().estimate.normalised_errors(truth)
    assert np.mean(np.abs(errors) < 2.0) > 0.9
    assert np.std(errors) > 0.5


def test_what_was_learnt_outlives_the_state_and_is_stored():
    truth = make_response()
    policy = AdaptivePolicy(wrong_response(), settings())
    before = policy.gain_matrix
    run(MaskedPolicy(policy, policy.response, np.ones(CORRECTORS, dtype=bool)), truth)
    assert off(policy.response, wrong_response()) > 0.1
    assert not np.allclose(policy.gain_matrix, before, rtol=0.1)
    kind = kind_of(policy)[0]
    stored = kind.make(kind.take(policy), policy.settings, policy.policy_id)
    for another in (policy, stored):
        begun = another.initial_state().estimate
        np.testing.assert_allclose(begun.response, policy.response, rtol=0, atol=1e-9)
        for mine, kept in zip(begun.covariances, policy.covariances, strict=True):
            np.testing.assert_allclose(mine, kept, rtol=1e-6, atol=1e-20)


def test_what_was_sent_counts_and_not_what_was_asked_for():
    truth = make_response()
    policy = AdaptivePolicy(truth, settings(prior_entry=1e-4))
    run(policy, truth, scale=0.5)
    assert off(policy.response, truth) < 0.02


def test_it_works_on_without_some_bpms():
    truth, valid = make_response(), EVERY.copy()
    valid[4] = False
    every = run(AdaptivePolicy(truth, settings(prior_entry=1e-6)), truth)
    fewer = run(AdaptivePolicy(truth, settings(prior_entry=1e-6)), truth, valid=valid)
    assert np.sqrt(np.mean(fewer[50:] ** 2)) < 1.5 * np.sqrt(np.mean(every[50:] ** 2))


def test_the_gain_matrix_is_what_it_does_of_a_steady_reading():
    truth = make_response()
    policy = AdaptivePolicy(truth, settings(prior_entry=1e-9))
    state = policy.initial_state()
    error = 0.05 * NOISE * np.random.default_rng(3).normal(size=BPMS)
    for _ in range(3000):
        change, state = policy.act(error, EVERY, state)
        state = policy.inform(error, EVERY, change, state)
    np.testing.assert_allclose(
        change, -policy.gain_matrix @ error, atol=0.02 * np.abs(change).max()
    )


def test_a_kick_makes_it_forget_the_orbit_and_not_the_response():
    truth = make_response()
    policy = AdaptivePolicy(truth, settings(prior_entry=1e-6))
    run(policy, truth, ticks=50)
    state = policy.initial_state()
    kick = truth @ np.random.default_rng(2).normal(size=CORRECTORS)
    change, state = policy.act(kick, EVERY, state)
    state = policy.inform(kick, EVERY, change, state)
    assert np.linalg.norm(kick + truth @ change) < 0.01 * np.linalg.norm(kick)
    assert off(state.estimate.response, truth) < 1e-2


@pytest.mark.parametrize("size", [1e-8, 1e-4])
def test_to_decide_teaches_nothing(size):
    policy = AdaptivePolicy(make_response(), settings())
    state = policy.initial_state()
    before = state.estimate.response.copy()
    first, _ = policy.act(np.full(BPMS, size), EVERY, state)
    again, _ = policy.act(np.full(BPMS, size), EVERY, state)
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(state.estimate.response, before)


def test_it_says_how_well_it_explains_what_it_reads():
    """About 1 while R̂, with its doubt, explains the readings; more where R has the other sign."""
    truth = make_response()
    policy = AdaptivePolicy(wrong_response(relative=0.0), settings())
    run(policy, truth)
    assert policy.chi2 < 1.2
    run(policy, -truth, ticks=20, seed=2)
    assert MaskedPolicy(policy, truth, np.ones(CORRECTORS, dtype=bool)).chi2 > 1.3


def test_a_trip_takes_back_what_was_learnt_shortly_before():
    truth = make_response()
    policy = AdaptivePolicy(wrong_response(), settings())
    run(policy, truth, ticks=650)
    before = policy.response
    run(policy, -truth, ticks=50, seed=2)
    assert off(policy.response, truth) > 2.0 * off(before, truth)
    MaskedPolicy(policy, truth, np.ones(CORRECTORS, dtype=bool)).take_back()
    assert off(policy.response, truth) < 1.2 * off(before, truth)
    kept = policy.response
    policy.take_back()
    assert policy.response is kept


def weak_mode(strength):
    """A response whose weakest mode has a strength [m/A], and that mode of the orbit, (n,)."""
    left, _, right = np.linalg.svd(make_response())
    strengths = np.full(CORRECTORS, 1e-4)
    strengths[-1] = strength
    return (left[:, :CORRECTORS] * strengths) @ right, left[:, CORRECTORS - 1]


def state_that_knows(response, period=30):
    """The defaults, with no doubt about a response."""
    settings = AdaptiveSettings()
    caution = settings.caution.model_copy(update={"period": period})
    known = [1e-20 * np.eye(CORRECTORS)] * settings.tracking.groups
    policy = AdaptivePolicy(response, settings.model_copy(update={"caution": caution}), known)
    return policy, policy.initial_state()


@pytest.mark.parametrize("strength", [2e-6, 2e-7, 2e-9])
def test_a_mode_that_is_known_to_have_lost_its_response_gets_little_current(strength):
    """Where nothing is doubted, an orbit x asks for x / 2 λ at most, however weak its mode is."""
    response, _ = weak_mode(strength)
    _, state = state_that_knows(response)
    damping = AdaptiveSettings().caution.regularisation
    assert np.linalg.norm(state.gain.near_modes, 2) <= 0.5001 / damping


@pytest.mark.parametrize("strength", [1e-5, 2e-6, 1e-6, 5e-7, 1e-7, 1e-9])
@pytest.mark.parametrize("period", [30, 10_000])
def test_an_orbit_that_a_weak_mode_cannot_reach_does_not_wind_the_correctors_up(strength, period):
    """No corrector comes to more than √(d / ν), and a mode that can answer corrects its orbit."""
    response, mode = weak_mode(strength)
    policy, state = state_that_knows(response, period)
    size, price = 10e-6, AdaptiveSettings().caution.price
    held, largest = np.zeros(CORRECTORS), 0.0
    for _ in range(3000):
        orbit = size * mode + response @ held
        change, state = policy.act(orbit, EVERY, state)
        change *= min(1.0, LIMITS.change_per_tick / np.abs(change).max())
        state = inform(policy, orbit, EVERY, change, state)
        held = held + change
        largest = max(largest, float(np.abs(held).max()))
    assert largest <= 1.05 * np.sqrt(size / price)
    assert np.abs(change).max() < 1e-3
    left = np.linalg.norm(orbit) / size
    assert left < 0.01 if strength > 5e-6 else left <= 1.01
