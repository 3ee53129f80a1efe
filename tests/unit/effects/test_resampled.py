"""Readings that are late because two noisy samples are averaged."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from test_sensor_effects import PLACES, ROWS, run, walk

from orbitfb.effects.registry import effect

KIND = effect("bpm-latency")


def resampled(ticks):
    return {"ticks": ticks, "resampled": 1.0}


def noisy(layout):
    """Orbits, and noise of their samples, shape (N, n) [m]."""
    noise = 0.2e-6 * np.random.default_rng(5).standard_normal((ROWS, len(layout.bpms)))
    return walk(layout), noise


@pytest.mark.parametrize("ticks", [0.3, 0.8, 1.0, 2.6])
def test_two_samples_are_averaged_with_their_noise(layout, ticks):
    orbit, noise = noisy(layout)
    read = run(KIND, layout, PLACES, resampled(ticks), orbit, noise)
    sample, whole = orbit + noise, int(ticks)
    at, part = np.arange(whole + 1, ROWS), ticks - whole
    expected = (1.0 - part) * sample[at - whole] + part * sample[at - whole - 1]
    assert_allclose(read[at][:, PLACES], expected[:, PLACES], rtol=0, atol=1e-15)
    assert_array_equal(np.delete(read, PLACES, axis=1), np.delete(sample, PLACES, axis=1))
