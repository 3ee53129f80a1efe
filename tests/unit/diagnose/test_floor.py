"""The floor of modes whose walks differ by orders of magnitude."""

import numpy as np

from orbitfb.diagnose.floor import estimate_floor
from orbitfb.diagnose.noise_modes import NoiseModes


def test_strong_modes_keep_their_own_walk_beside_weak_ones():
    walk = np.array([7.0, 6.0, 2.0, 1.5, 0.8, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005])
    rows = 1000
    rng = np.random.default_rng(0)
    orbit = np.cumsum(rng.normal(size=(rows, len(walk))) * np.sqrt(walk), axis=0)
    readings = orbit + rng.normal(size=orbit.shape)
    starts = np.arange(rows) == 0

    floor = estimate_floor(readings, starts, NoiseModes.even(np.eye(len(walk))))

    assert abs(floor.reading - 1.0) < 0.05
    np.testing.assert_allclose(floor.walk[:8], walk[:8], rtol=0.25)
    # Mean squares of 1000 rows scatter by 0.045.
    np.testing.assert_allclose(np.mean(floor.whiten(readings, starts) ** 2, axis=0), 1.0, atol=0.15)


def test_a_walk_far_beyond_the_reading_noise_has_its_own_level():
    rows, far = 1000, 3000.0
    walk = np.array([far, 90.0, 5.0, 1.0, 0.5, 0.2, 0.1, 0.05])
    rng = np.random.default_rng(1)
    readings = np.cumsum(rng.normal(size=(rows, len(walk))) * np.sqrt(walk), axis=0)
    readings += rng.normal(size=readings.shape)
    starts = np.arange(rows) == 0

    floor = estimate_floor(readings, starts, NoiseModes.even(np.eye(len(walk))))

    assert abs(floor.walk[0] / far - 1.0) < 0.15
    np.testing.assert_allclose(np.mean(floor.whiten(readings, starts) ** 2, axis=0), 1.0, atol=0.15)


def test_the_reading_noise_below_walks_that_all_are_greater_has_its_level():
    rows, modes = 1000, 24
    walk = np.exp(np.linspace(np.log(2.0), np.log(10.0), modes))
    rng = np.random.default_rng(2)
    readings = np.cumsum(rng.normal(size=(rows, modes)) * np.sqrt(walk), axis=0)
    readings += rng.normal(size=readings.shape)
    starts = np.arange(rows) == 0

    floor = estimate_floor(readings, starts, NoiseModes.even(np.eye(modes)))

    assert abs(floor.reading - 1.0) < 0.15
    # The mean square of 24,000 innovations scatters by 0.009.
    assert abs(np.mean(floor.whiten(readings, starts) ** 2) - 1.0) < 0.02
