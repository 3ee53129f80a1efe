"""What the loop, the store and the learner rely on, for every policy there is."""

import threading

import numpy as np
import pytest
from policy_examples import BPMS, CORRECTORS, EXAMPLES, make_response, policy_classes
from store_examples import ring

from orbitfb.core.errors import ConfigError
from orbitfb.core.ports import inform
from orbitfb.policies.masking import MaskedPolicy
from orbitfb.policies.store.card import check_identifier

EVERY = np.ones(BPMS, dtype=bool)
RESPONSE = make_response()
SIZES = (1e-9, 1e-7, 1e-6, 1e-4, 1e-3)

every_policy = pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.name)


def orbit(size, seed=1):
    return size * np.random.default_rng(seed).normal(size=BPMS)


def act(policy, error, valid=EVERY):
    return policy.act(error, valid, policy.initial_state())[0]


def test_no_policy_comes_untested():
    assert policy_classes() == {example.kind for example in EXAMPLES}, (
        "a policy is missing in tests/unit/policies/policy_examples.py"
    )


@every_policy
def test_it_is_of_the_class_that_its_example_names(example):
    assert type(example.make(RESPONSE)).__name__ == example.kind


@every_policy
def test_a_perfect_orbit_is_left_alone(example):
    np.testing.assert_array_equal(act(example.make(RESPONSE), np.zeros(BPMS)), np.zeros(CORRECTORS))


@every_policy
@pytest.mark.parametrize("size", SIZES)
def test_a_change_is_a_finite_vector_of_its_own(example, size):
    policy, error = example.make(RESPONSE), orbit(size)
    change = act(policy, error)
    assert (change.shape, change.dtype) == ((CORRECTORS,), np.float64)
    assert np.isfinite(change).all()
    np.testing.assert_array_equal(error, orbit(size))  # what was handed in is as it was
    before = change.copy()
    change[:] = 7.0  # the caller may write into what it got
    np.testing.assert_array_equal(act(policy, error), before)


@every_policy
@pytest.mark.parametrize("size", SIZES)
def test_it_makes_an_orbit_smaller_that_the_correctors_can_make(example, size):
    policy = example.make(RESPONSE)
    currents = np.random.default_rng(2).normal(size=CORRECTORS)
    if isinstance(policy, MaskedPolicy):
        currents[~policy.movable] = 0.0
    error = RESPONSE @ currents
    error *= size / np.sqrt(np.mean(error**2))
    state = policy.initial_state()
    left = error
    for _ in range(3):
        change, state = policy.act(left, EVERY, state)
        assert (RESPONSE @ change) @ left < 0.0  # downhill
        left = left + RESPONSE @ change
    assert np.linalg.norm(left) < 0.9 * np.linalg.norm(error)


@every_policy
def test_with_few_bpms_it_moves_in_no_more_directions_than_they_are(example):
    """What the valid BPMs do not see of a change nobody corrects: noise would add up there."""
    policy, valid = example.make(RESPONSE), EVERY.copy()
    valid[[0, 5, 6, 9, 11]] = False
    state, changes = policy.initial_state(), []
    for tick in range(60):
        error = np.where(valid, orbit(SIZES[tick % len(SIZES)], tick), np.nan)
        change, state = policy.act(error, valid, state)
        state = inform(policy, error, valid, change, state)
        changes.append(change / np.linalg.norm(change))
    strengths = np.linalg.svd(np.array(changes), compute_uv=False)
    assert valid.sum() < CORRECTORS
    assert strengths[valid.sum()] < 1e-9 * strengths[0]


@every_policy
def test_a_masked_bpm_is_not_heard(example):
    policy, valid = example.make(RESPONSE), EVERY.copy()
    valid[[0, 5]] = False
    changes = []
    for content in (0.0, 1.0, np.nan, np.inf):
        error = orbit(1e-5)
        error[~valid] = content
        changes.append(act(policy, error, valid))
    assert np.isfinite(changes[0]).all()
    assert changes[0].any()
    for change in changes[1:]:
        np.testing.assert_array_equal(change, changes[0])


@every_policy
def test_with_no_bpm_at_all_nothing_is_changed(example):
    change = act(example.make(RESPONSE), np.full(BPMS, np.nan), np.zeros(BPMS, dtype=bool))
    np.testing.assert_array_equal(change, np.zeros(CORRECTORS))


@every_policy
def test_a_masked_corrector_does_not_move(example):
    movable = np.ones(CORRECTORS, dtype=bool)
    movable[[1, 8]] = False
    policy = MaskedPolicy(example.make(RESPONSE), RESPONSE, movable)
    state = policy.initial_state()
    for seed in range(4):
        change, state = policy.act(orbit(1e-5, seed), EVERY, state)
        np.testing.assert_array_equal(change[~movable], 0.0)
        assert change[movable].any()
    np.testing.assert_array_equal(policy.gain_matrix[~movable], 0.0)


@every_policy
def test_its_name_is_stable_and_follows_its_content(example):
    name = example.make(RESPONSE).policy_id
    assert check_identifier(name) == name
    assert example.make(RESPONSE.copy(order="F")).policy_id == name
    assert example.make(1.001 * RESPONSE).policy_id != name


@every_policy
def test_what_is_stored_decides_the_same(example, store):
    policy = example.make(RESPONSE)
    channels = ring(BPMS, CORRECTORS)
    loaded = store.load(store.save(policy, channels), channels)
    if isinstance(policy, MaskedPolicy):  # the mask stands in the configuration
        loaded = MaskedPolicy(loaded, RESPONSE, policy.movable)
    assert loaded.policy_id == policy.policy_id
    for size in SIZES:
        np.testing.assert_array_equal(act(loaded, orbit(size)), act(policy, orbit(size)))


@every_policy
def test_a_batch_is_decided_as_one_by_one(example):
    policy = example.make(RESPONSE)
    errors = np.array([[orbit(size, seed) for size in SIZES] for seed in range(3)])
    if not example.memoryless:
        with pytest.raises(ConfigError, match="earlier orbits"):
            policy.changes(errors)
        return
    changes = policy.changes(errors)
    assert changes.shape == (3, len(SIZES), CORRECTORS)
    one_by_one = np.array([[act(policy, error) for error in row] for row in errors])
    scale = np.abs(one_by_one).max(axis=-1, keepdims=True)
    assert np.all(np.abs(changes - one_by_one) <= example.exact * scale)


@every_policy
def test_the_state_is_a_value(example):
    """The loop hands an old state in again whenever a change was not written."""
    policy = example.make(RESPONSE)
    _, state = policy.act(orbit(1e-5, 1), EVERY, policy.initial_state())
    first, _ = policy.act(orbit(1e-5, 2), EVERY, state)
    policy.act(orbit(1e-5, 3), EVERY, state)
    again, _ = policy.act(orbit(1e-5, 2), EVERY, state)
    np.testing.assert_array_equal(first, again)


@every_policy
def test_threads_can_share_it(example):
    policy = example.make(RESPONSE)
    tasks = []
    for seed in range(24):  # more masks than are kept
        valid = EVERY.copy()
        valid[[seed % BPMS, (5 * seed) % BPMS]] = seed % 5 == 0
        tasks.append((orbit(1e-5, seed), valid))
    alone = [act(example.make(RESPONSE), *task) for task in tasks]
    wrong = []

    def work(offset):
        for step in range(3 * len(tasks)):
            index = (step + offset) % len(tasks)
            if not np.array_equal(act(policy, *tasks[index]), alone[index]):
                wrong.append(index)

    threads = [threading.Thread(target=work, args=(7 * k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


@pytest.mark.parametrize(
    "example",
    [example for example in EXAMPLES if example.memoryless],  # a first change with an integral
    ids=lambda example: example.name,  # has its share too; the matrix is the proportional law's
)
def test_the_gain_matrix_is_the_slope_at_zero(example):
    policy = example.make(RESPONSE)
    assert policy.gain_matrix.shape == (CORRECTORS, BPMS)
    step = 1e-12
    slopes = [
        (act(policy, -step * unit) - act(policy, step * unit)) / (2.0 * step)
        for unit in np.eye(BPMS)
    ]
    scale = np.abs(policy.gain_matrix).max()
    np.testing.assert_allclose(np.array(slopes).T, policy.gain_matrix, atol=example.exact * scale)


@every_policy
def test_it_says_which_response_it_was_made_for(example):
    np.testing.assert_array_equal(example.make(RESPONSE).response, RESPONSE)
