"""The diagnosis on the naive one-step residual: its floor against the residual itself."""

import numpy as np
import pytest
from gap_cases import record

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.noise_modes import NoiseModes
from tests.blind.baselines.naive import naive, naive_floor


def test_innovations_are_the_changes_of_what_is_left() -> None:
    rng = np.random.default_rng(0)
    left = np.cumsum(rng.standard_normal((400, 6)) * np.array([1, 2, 3, 1, 1, 5]) * 1e-7, axis=0)
    left += 3e-7 * rng.standard_normal(left.shape)
    left[150:] += 1e-4  # another stretch: its beginning tells nothing of the noise
    starts = np.zeros(400, dtype=np.bool_)
    starts[[0, 150]] = True
    axes = np.linalg.qr(rng.standard_normal((6, 6)))[0]
    floor = naive_floor(left, starts, NoiseModes.even(axes))
    innovation, deviation = floor.innovations(left, starts)
    steps = np.diff(left, axis=0, prepend=left[:1])
    steps[starts] = 0.0
    np.testing.assert_allclose(innovation, steps, atol=1e-5 * np.abs(steps).max())
    spread = np.sqrt(np.mean(steps[~starts] ** 2, axis=0))
    np.testing.assert_allclose(deviation[1:150], np.tile(spread, (149, 1)), rtol=1e-5)
    assert floor.gains == pytest.approx(np.ones(6), abs=1e-5)


def test_a_bpm_that_stands_still_has_a_floor_too() -> None:
    left = np.random.default_rng(0).standard_normal((50, 3)) * 1e-7
    left[:, 1] = 0.0
    floor = naive_floor(left, np.arange(50) == 0, NoiseModes.even(np.eye(3)))
    assert np.isfinite(floor.whiten(left, np.arange(50) == 0)).all()


def test_the_diagnosis_takes_it_in_the_place_of_its_own() -> None:
    whole = record(False)
    with naive():
        bench = Bench(whole, background=0.0)
    assert bench.floor.gains == pytest.approx(np.ones(len(bench.floor.gains)), abs=1e-4)
    moves = np.diff(whole.setpoints, axis=0) @ whole.layout.response.T
    np.testing.assert_allclose(bench.orbit[1:], whole.readings[:-1] + moves, atol=1e-11)
    assert Bench(whole).floor.gains.max() < 0.9
