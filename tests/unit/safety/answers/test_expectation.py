"""What the next orbit should be, and what is owed by those who have not answered."""

import numpy as np
import pytest

from orbitfb.core.signals import FINEST
from orbitfb.safety.answers.expectation import Expectation, Owed, shown
from orbitfb.safety.answers.questions import Ring

N, M = 30, 24
NOISE = 0.2e-6
ALL = np.ones(N, dtype=np.bool_)
NOTHING, NO_CHANGE = np.zeros(N), np.zeros(M)


@pytest.fixture(scope="module")
def ring():
    response = 3e-4 * np.random.default_rng(1).standard_normal((N, M))
    return Ring.of(response, np.ones(M, dtype=np.bool_))


def quiet(expected, orbits, seed=3):
    random = np.random.default_rng(seed)
    for _ in range(orbits):
        reading = NOISE * random.standard_normal(N)
        expected = expected.follow(reading, NOTHING, NO_CHANGE, ALL)
    return expected


def test_a_move_that_was_sent_is_no_surprise(ring):
    change = 1e-3 * np.random.default_rng(4).standard_normal(M)
    moved = ring.response @ change
    expected = Expectation.first(NOTHING, M)
    assert np.abs(expected.surprise(moved, moved)).max() < FINEST
    after = expected.follow(moved, moved, change, ALL)
    assert np.allclose(after.model, moved)
    assert np.array_equal(after.recent, change)


def test_the_usual_size_of_a_surprise_is_the_noise_and_is_found_again_after_a_kick():
    expected = quiet(Expectation.first(NOTHING, M), 200)
    assert np.median(expected.spread) == pytest.approx(1.1 * NOISE, rel=0.2)
    for _ in range(5):
        expected = expected.follow(50e-6 * np.ones(N), NOTHING, NO_CHANGE, ALL)
    expected = quiet(expected, 60)
    assert np.median(expected.spread) < 2.5 * NOISE


def test_a_bpm_that_is_not_seen_keeps_what_is_known_of_it():
    expected = quiet(Expectation.first(NOTHING, M), 50)
    after = expected.follow(np.full(N, 1e-3), NOTHING, NO_CHANGE, np.arange(N) != 2)
    assert after.spread[2] == expected.spread[2]
    assert after.model[2] == expected.model[2]


def test_what_is_asked_for_is_owed_until_it_is_answered(ring):
    change = 1e-3 * np.ones(M)
    moved = ring.response @ change
    owed = Owed.nothing(N, M).add(moved, change).add(moved, change)
    assert np.allclose(owed.bpms, 2 * moved)
    assert np.allclose(owed.sizes(ring)[N:], 2e-3 * ring.sizes)
    paid = owed.paid(False, np.arange(N + M) == 1)
    assert paid.bpms[1] == 0.0
    assert np.allclose(paid.ring, 2 * moved)
    assert not owed.paid(True, np.zeros(N + M, dtype=np.bool_)).ring.any()


@pytest.mark.parametrize("part", [1.0, 0.8, 0.4, 0.0, -1.0])
def test_a_large_step_shows_by_itself_if_it_came(ring, part):
    random = np.random.default_rng(5)
    change = 5e-2 * random.standard_normal(M)
    moved = ring.response @ change
    step = part * moved + NOISE * random.standard_normal(N)
    whole, devices = shown(step, moved, change, ALL, np.full(N, NOISE), 2e-6, ring)
    assert whole is (part > 0.5)
    assert devices.any() is np.bool_(part > 0.5)


def test_a_large_step_tells_of_the_one_bpm_that_did_not_see_it_and_of_the_one_deaf_corrector(ring):
    change = 5e-2 * np.random.default_rng(6).choice([-1.0, 1.0], M)
    moved = ring.response @ change
    step = moved - ring.response[:, 9] * change[9]
    step[4] = 0.0
    whole, devices = shown(step, moved, change, ALL, np.full(N, NOISE), 2e-6, ring)
    assert whole
    assert not devices[4]
    assert not devices[N + 9]
    assert devices[N:].sum() >= M // 2


def test_a_step_shows_though_the_orbit_was_unquiet_of_late_but_not_for_a_bpm_that_is_noisy(ring):
    change = np.zeros(len(ring.sizes))
    change[3] = 50e-6 / ring.sizes[3]
    moved, seen = ring.response @ change, np.ones(len(ring.response), dtype=bool)
    step = moved + 0.2e-6 * np.random.default_rng(1).standard_normal(len(moved))
    unquiet = np.full(len(moved), 30e-6)
    unquiet[5] = 30e-3
    whole, devices = shown(step, moved, change, seen, unquiet, 2e-6, ring)
    assert whole
    assert devices[: len(moved)].mean() > 0.8
    assert not devices[5]
    assert not shown(step - moved, moved, change, seen, unquiet, 2e-6, ring)[0]


def test_a_small_step_shows_nothing(ring):
    change = 1e-4 * np.ones(M)
    moved = ring.response @ change
    whole, devices = shown(moved, moved, change, ALL, np.full(N, NOISE), 2e-6, ring)
    assert not whole
    assert not devices.any()
