"""A drift whose steps go on in their direction is no gain, no delay and no tune."""

import numpy as np
import pytest

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.drift_memory import echoes
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fit import fit
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.diagnose.noise_modes import NoiseModes
from orbitfb.diagnose.quick import Quick
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.build import layout_of
from orbitfb.effects.registry import effect
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import PlantSettings

RING = Ring.load()
LAYOUT = layout_of(RING, "x", 0.1)


def going_on(rows: int, size: Vector, memory: float, rng: np.random.Generator) -> Matrix:
    """A walk whose steps, of these rms values, go with those before."""
    steps = rng.standard_normal((rows, len(size)))
    for row in range(1, rows):
        steps[row] = memory * steps[row - 1] + np.sqrt(1.0 - memory**2) * steps[row]
    return np.cumsum(steps * size, axis=0)


def exact(readings: Vector, walk: float, memory: float) -> float:
    """Log-likelihood of a mode by a Kalman filter of its orbit and its step [nats]."""
    move = np.array([[1.0, memory], [0.0, memory]])
    new = walk * (1.0 - memory**2) * np.ones((2, 2))
    state, known = np.array([readings[0], 0.0]), np.diag([1.0, walk])
    total = 0.0
    for reading in readings[1:]:
        state, known = move @ state, move @ known @ move.T + new
        variance = known[0, 0] + 1.0
        error = reading - state[0]
        gain = known[:, 0] / variance
        state, known = state + gain * error, known - np.outer(gain, known[0])
        total -= 0.5 * (error**2 / variance + np.log(variance))
    return float(total)


def test_the_echo_finds_the_memory_that_an_exact_filter_finds() -> None:
    walk, memory, rng = np.array([300.0, 30.0, 3.0, 0.3, 0.03]), 0.3, np.random.default_rng(1)
    readings = going_on(2000, np.sqrt(walk), memory, rng) + rng.standard_normal((2000, 5))
    starts = np.arange(2000) == 0
    floor = NoiseFloor(NoiseModes.even(np.eye(5)), 1.0, walk)
    white = floor.whiten(readings, starts)

    columns = echoes(Quick(floor, starts), white.astype(np.float32))

    pull, known = columns @ white.ravel(), columns @ columns.T
    values = np.linalg.solve(known, pull)
    tried = np.linspace(0.1, 0.5, 41)
    likely = [sum(map(exact, readings.T, walk, np.full(5, one))) for one in tried]
    best = int(np.argmax(likely))
    nothing = sum(map(exact, readings.T, walk, np.zeros(5)))
    assert values[1] == pytest.approx(tried[best], abs=0.05)
    assert 0.5 * pull @ values == pytest.approx(likely[best] - nothing, rel=0.15)


def test_modes_that_hardly_walk_tell_nothing_of_a_memory() -> None:
    floor = NoiseFloor(NoiseModes.even(np.eye(5)), 1.0, np.full(5, 1e-4))
    white = np.random.default_rng(1).standard_normal((2000, 5)).astype(np.float32)
    assert not len(echoes(Quick(floor, np.arange(2000) == 0), white))


def test_an_orbit_that_runs_away_is_no_drift_with_a_memory() -> None:
    walk = np.array([300.0, 30.0, 3.0, 0.3, 0.03])
    floor = NoiseFloor(NoiseModes.even(np.eye(5)), 1.0, walk)
    starts = np.arange(500) == 0
    readings = np.random.default_rng(1).standard_normal((500, 5))
    readings += np.exp(np.arange(500) / 40.0)[:, None]
    white = floor.whiten(readings, starts).astype(np.float32)
    assert not len(echoes(Quick(floor, starts), white))


def test_one_bpm_is_enough() -> None:
    rng, starts = np.random.default_rng(1), np.arange(900) == 0
    readings = going_on(900, np.array([5.0]), 0.4, rng) + rng.standard_normal((900, 1))
    floor = NoiseFloor(NoiseModes.even(np.eye(1)), 1.0, np.array([25.0]))
    assert len(echoes(Quick(floor, starts), floor.whiten(readings, starts).astype(np.float32)))


class GoingOn(Effect):
    """Magnets at all correctors that go on as they went."""

    def __init__(self, rows: int, memory: float, rng: np.random.Generator) -> None:
        kicks = going_on(rows, np.ones(LAYOUT.response.shape[1]), memory, rng)
        orbit = kicks @ LAYOUT.response.T
        self._orbit = orbit * (0.3e-6 / np.sqrt(np.mean(np.diff(orbit, axis=0) ** 2)))

    def disturb(self, orbit: Vector, tick: int) -> Vector:
        return orbit + self._orbit[tick]


@pytest.mark.parametrize(
    ("name", "values"), [("corrector-gain", {"gain": -0.05}), ("corrector-lag", {"tau": 0.01})]
)
def test_a_loop_that_steers_a_drift_with_a_memory_has_no_wrong_correctors(
    name: str, values: dict[str, float]
) -> None:
    drift = GoingOn(1001, 0.3, np.random.default_rng(2))
    still = PlantSettings(ground_motion_rms=0.0)
    record = simulate_record(RING, "x", 800, 3, [drift], plant=still, steering=0)
    every = tuple(range(len(LAYOUT.correctors.names)))
    found = fit(Bench(record), (Cause(effect(name), every, values),))
    assert found.gain < 4.0
