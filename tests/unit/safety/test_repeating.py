"""A reading with a coarse last digit repeats itself; one that hangs is still found."""

import numpy as np
import pytest

from orbitfb.safety.bpms import BpmMemory, Flaw, bpm_quota, screen
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.repeating import LONGEST, Habit

SETTINGS = InterlockSettings()
SIZE, NOISE = 45, 0.2e-6


def run(orbits, memory=None):
    """Screen orbits, shape (ticks, n) [m]; the flaws, shape (ticks, n), and the memory."""
    memory = memory or BpmMemory.first(orbits.shape[1], SETTINGS)
    flaws = []
    for orbit in orbits:
        its, memory = screen(orbit, orbit, np.ones(len(orbit), dtype=bool), memory, SETTINGS)
        flaws.append(its)
    return np.array(flaws), memory


def readings(ticks, digit, seed=3, offset=50e-6):
    rng = np.random.default_rng(seed)
    orbits = offset * rng.standard_normal(SIZE) + NOISE * rng.standard_normal((ticks, SIZE))
    return np.round(orbits / digit) * digit if digit else orbits


@pytest.mark.parametrize(
    "digit",
    [
        0.0,
        pytest.param(0.1e-6, marks=pytest.mark.nightly),
        pytest.param(0.2e-6, marks=pytest.mark.nightly),
        0.4e-6,
    ],
)
def test_coarse_readings_are_soon_not_frozen(digit):
    flaws, _ = run(readings(3000, digit))
    assert (flaws[200:] == Flaw.FROZEN).mean() < 1e-4
    assert ((flaws[200:] > 0).sum(axis=1) <= SETTINGS.max_invalid_bpms).all()


def test_readings_five_times_as_coarse_as_their_noise_are_learnt_too():
    flaws, _ = run(readings(4000, 1e-6))
    late = (flaws[2000:] > 0).sum(axis=1)
    assert (late <= SETTINGS.max_invalid_bpms).mean() > 0.99


@pytest.mark.parametrize("digit", [0.1e-6, 0.2e-6, 0.4e-6])
def test_coarse_readings_of_a_corrected_orbit_are_believed_after_some_ticks(digit):
    """They are often exactly 0, and all are alike: a loop need not wait until each is known."""
    flaws, _ = run(readings(400, digit, offset=1e-6))
    assert ((flaws[12:] > 0).sum(axis=1) <= SETTINGS.max_invalid_bpms).all()
    assert (flaws[100:] > 0).mean() < 0.01


def test_a_dead_channel_among_coarse_ones_is_found_within_its_own_time():
    orbits = readings(500, 0.2e-6, offset=1e-6)
    orbits[400:, 7] = 0.0
    flaws, _ = run(orbits)
    found = np.flatnonzero(flaws[400:, 7] == Flaw.FROZEN)
    assert found[0] <= 30 and len(found) == 100 - found[0]


def test_a_bpm_that_has_hung_is_not_believed_when_it_reads_nought():
    orbits = readings(200, 0.0, offset=1e-6)
    orbits[20:60, 7] = orbits[20, 7]
    orbits[90:, 7] = 0.0
    flaws, _ = run(orbits)
    assert (flaws[90:, 7] == Flaw.ZERO).any() and (flaws[90:, 7] > 0).all()


def test_a_channel_that_dies_now_and_then_does_not_teach_that_zeros_are_readings():
    orbits = readings(3000, 0.0, offset=1e-6)
    for begin in range(50, 3000, 20):
        orbits[begin : begin + 8, 7] = 0.0
    flaws, _ = run(orbits)
    assert (flaws[orbits[:, 7] == 0.0, 7] > 0).all()


@pytest.mark.parametrize(("digit", "most"), [(0.0, 2), (0.2e-6, 30)])
def test_a_bpm_that_hangs_is_found_within_its_own_time(digit, most):
    orbits = readings(1100, digit)
    orbits[1000:, 7] = orbits[999, 7]
    flaws, memory = run(orbits)
    found = np.flatnonzero(flaws[1000:, 7] == Flaw.FROZEN)
    assert found[0] <= most and len(found) >= 100 - most - 1
    assert memory.habit.frozen_from(2)[7] <= most + 2  # it taught nothing while it hung


def test_a_bpm_that_hangs_now_and_then_is_not_taken_for_a_coarse_one():
    orbits = readings(4000, 0.0)
    for begin in range(300, 4000, 300):
        orbits[begin : begin + 100, 7] = orbits[begin, 7]
    flaws, _ = run(orbits)
    for begin in range(300, 4000, 300):
        assert np.flatnonzero(flaws[begin : begin + 100, 7] == Flaw.FROZEN)[0] <= 10


def test_nothing_is_ever_left_alone_for_longer_than_the_longest():
    habit = Habit(np.full(2, 1e9), np.ones(2))
    assert (habit.frozen_from(2) == LONGEST).all()


def test_the_reason_names_the_key():
    flaws = np.full(3, Flaw.FROZEN, dtype=np.int8)
    told = bpm_quota(np.zeros(3, dtype=bool), SETTINGS, ("A", "B", "C"), flaws=flaws)
    assert "interlocks.bpm_frozen_ticks" in told.reason
