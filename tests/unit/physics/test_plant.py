"""The plant: closed forms of what it does, and that its parts do not disturb each other."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydantic import ValidationError

from orbitfb.core.errors import WriteError
from orbitfb.physics.drift import DriftSettings
from orbitfb.physics.effect import Effect, generator
from orbitfb.physics.plant import Plant, PlantSettings
from orbitfb.physics.response import response

QUIET = PlantSettings(bpm_noise_rms=0, ground_motion_rms=0, initial_orbit_rms=0)


def quiet(**changes):
    return PlantSettings(**(QUIET.model_dump() | changes))


def rms(values, axis=None):
    return np.sqrt(np.mean(np.square(values), axis=axis))


def orbits(plant, ticks):
    setpoints = np.zeros(len(plant.channels.correctors))
    states = [plant.step(setpoints) for _ in range(ticks)]
    return np.array([s.true_orbit for s in states]), np.array([s.reading for s in states])


@pytest.mark.parametrize("planes", ["x", "y", "xy"])
def test_a_quiet_ring_gives_the_linear_orbit(ring, planes):
    plant = Plant(ring, planes, QUIET)
    setpoints = np.random.default_rng(0).standard_normal(len(plant.channels.correctors))
    state = plant.step(setpoints)
    assert_allclose(state.true_orbit, response(ring, planes) @ setpoints, rtol=1e-12)
    assert_array_equal(state.reading, state.true_orbit)
    assert_array_equal(state.readback, setpoints)
    assert plant.tick == 1


def test_the_readings_carry_white_noise_of_the_stated_size(ring):
    true, read = orbits(Plant(ring, "x", quiet(bpm_noise_rms=0.2e-6)), 500)
    noise = read - true
    assert rms(noise) == pytest.approx(0.2e-6, rel=0.02)  # 90,000 samples: 0.24 % (1 sigma)
    correlation = np.mean(noise[1:] * noise[:-1]) / np.mean(noise**2)
    assert abs(correlation) < 0.02


@pytest.mark.parametrize("planes", ["x", "y", "xy"])
def test_the_ground_moves_the_orbit_by_the_stated_rms_per_tick(ring, planes):
    true, _ = orbits(Plant(ring, planes, quiet(ground_motion_rms=0.04e-6)), 3000)
    steps = np.diff(true, axis=0)
    for plane in np.split(steps, len(planes), axis=1):
        # few collective modes carry it, so 3,000 ticks still scatter by some per cent
        assert rms(plane) == pytest.approx(0.04e-6, rel=0.05)


def test_the_ground_forgets_as_an_ar1_process_does(ring):
    memory, step = 20.0, 0.04e-6
    settings = quiet(ground_motion_rms=step, ground_motion_memory=memory)
    true, _ = orbits(Plant(ring, "x", settings), 6000)
    wanted = step / np.sqrt(1 - np.exp(-2 / memory))
    assert rms(true[200:]) == pytest.approx(wanted, rel=0.1)


@pytest.mark.parametrize("planes", ["x", "y", "xy"])
@pytest.mark.parametrize("seed", range(3))
def test_the_initial_orbit_has_its_rms_and_can_be_corrected(ring, planes, seed):
    plant = Plant(ring, planes, seed=seed)
    (orbit,), _ = orbits(plant, 1)
    for plane in np.split(orbit, len(planes)):
        assert rms(plane) == pytest.approx(250e-6, rel=1e-9)
    left, values, right = np.linalg.svd(plant.response)
    damping = 50e-6
    setpoints = -right.T @ (values / (values**2 + damping**2) * (left.T @ orbit))
    assert np.max(np.abs(setpoints)) < 18.0
    assert rms(orbit + plant.response @ setpoints) < 2e-6


def test_a_kick_steps_the_orbit_for_good(ring):
    plant = Plant(ring, "xy", QUIET)
    (before,), _ = orbits(plant, 1)
    plant.kick(10e-6)
    (after, later), _ = orbits(plant, 2)
    for plane in np.split(after - before, 2):
        assert rms(plane) == pytest.approx(10e-6)
    assert_array_equal(after, later)
    plant.kick(10e-6)
    (again,), _ = orbits(plant, 1)
    assert rms(again - after) == pytest.approx(10e-6)


def test_the_response_drifts_linearly_and_then_stays(ring):
    plant = Plant(ring, "x", quiet(drift={"preset": "paper", "ticks": 10}), seed=3)
    responses = []
    for _ in range(13):
        responses.append(plant.response)
        orbits(plant, 1)
    first, last = responses[0], responses[-1]
    assert_array_equal(first, response(ring, "x"))
    assert_allclose(responses[5], (first + last) / 2, rtol=1e-9, atol=1e-15)
    assert_array_equal(responses[10], last)
    assert 0.05 < np.linalg.norm(last - first) / np.linalg.norm(first) < 0.15


@pytest.mark.parametrize("preset", ["paper", "mild", "strong"])
@pytest.mark.parametrize("planes", ["x", "xy"])
def test_the_stated_response_is_the_one_in_force(ring, preset, planes):
    plant = Plant(ring, planes, quiet(drift={"preset": preset, "ticks": 7}), seed=1)
    setpoints = np.random.default_rng(0).standard_normal(len(plant.channels.correctors))
    for _ in range(9):
        wanted = plant.response @ setpoints
        assert_allclose(plant.step(setpoints).true_orbit, wanted, rtol=1e-9, atol=1e-15)


def test_gains_and_matrix_noise_have_their_stated_size(ring):
    drift = {"ticks": 1, "beta_beat": 0, "bpm_gain_rms": 0.02, "matrix_noise": 1e-9}
    plant = Plant(ring, "x", quiet(drift=drift))
    start = plant.response
    orbits(plant, 1)
    nominal = response(ring, "x")
    assert rms(start - nominal) == pytest.approx(1e-9, rel=0.02)
    gains = np.median(plant.response / nominal, axis=1)
    assert rms(gains - 1) == pytest.approx(0.02, rel=0.2)


def test_a_strong_drift_is_ill_conditioned_and_planes_stay_uncoupled(ring):
    plant = Plant(ring, "xy", quiet(drift=DriftSettings(preset="strong", ticks=1)))
    assert np.linalg.cond(plant.response[:180, :180]) > 4000
    orbits(plant, 1)
    assert not plant.response[:180, 180:].any()


def test_a_preset_fills_in_what_is_not_given():
    assert DriftSettings().ticks == 0
    assert DriftSettings(preset="mild").beta_beat == 0.03
    assert DriftSettings(preset="mild", beta_beat=0.04).beta_beat == 0.04
    assert DriftSettings(preset="strong").matrix_noise == 3e-6
    strong = DriftSettings(preset="strong", ticks=5)
    assert DriftSettings.model_validate(strong.model_dump()) == strong


@pytest.mark.parametrize("wrong", [{"preset": "wild"}, {"tick": 3}, {"ticks": -1}])
def test_wrong_drift_settings_are_refused(wrong):
    with pytest.raises(ValidationError):
        DriftSettings.model_validate(wrong)


def test_the_same_seed_gives_the_same_numbers_and_another_one_others(ring):
    settings = PlantSettings(drift=DriftSettings(preset="strong", ticks=5))
    runs = [np.array(orbits(Plant(ring, "x", settings, seed), 10)) for seed in (4, 4, 5)]
    assert_array_equal(runs[0], runs[1])
    assert np.all(runs[0] != runs[2])


def test_every_effect_and_every_seed_has_numbers_of_its_own():
    draws = {
        tuple(generator(seed, name).standard_normal(3))
        for seed in (0, 1)
        for name in ("BPM noise", "ground motion", "drift")
    }
    assert len(draws) == 6


class Spikes(Effect):
    """An effect as the later ones will be: its own numbers, one hook."""

    def __init__(self, rng):
        self._rng = rng

    def sense(self, orbit, tick):
        return orbit + 1e-3 * self._rng.standard_normal(orbit.shape)


def test_an_effect_more_or_less_leaves_the_numbers_of_the_others(ring):
    alone = Plant(ring, "x", seed=2)
    joined = Plant(ring, "x", seed=2, effects=[Spikes(generator(2, "spikes"))])
    without_noise = Plant(ring, "x", PlantSettings(bpm_noise_rms=0), seed=2)
    true, read = orbits(alone, 20)
    joined_true, joined_read = orbits(joined, 20)
    silent_true, _ = orbits(without_noise, 20)
    assert_array_equal(true, joined_true)
    assert_array_equal(true, silent_true)
    spikes = 1e-3 * generator(2, "spikes").standard_normal((20, 180))
    assert_allclose(joined_read, read + spikes, rtol=1e-12)


def test_an_effect_joins_every_stage(ring):
    class Everywhere(Effect):
        def actuate(self, setpoints, tick):
            return 2 * setpoints

        def respond(self, orbit, currents, tick):
            return 3 * orbit

        def disturb(self, orbit, tick):
            return orbit + 5e-6

        def sense(self, orbit, tick):
            return orbit + 7e-6 * tick

    plant = Plant(ring, "x", QUIET, effects=[Everywhere()])
    setpoints = np.ones(180)
    plant.step(setpoints)
    state = plant.step(setpoints)
    nominal = response(ring, "x")
    assert_allclose(state.readback, 2.0)
    assert_allclose(state.true_orbit, 6 * nominal.sum(axis=1) + 5e-6, rtol=1e-9)
    assert_allclose(state.reading, state.true_orbit + 7e-6, rtol=1e-9)
    assert_allclose(plant.response, 3 * nominal)
    assert_array_equal(setpoints, 1.0)


@pytest.mark.parametrize("setpoints", [np.zeros(179), np.full(180, np.nan), np.full(180, np.inf)])
def test_wrong_setpoints_are_refused_and_no_time_passes(ring, setpoints):
    plant = Plant(ring, "x")
    with pytest.raises(WriteError, match="give 180 finite currents"):
        plant.step(setpoints)
    assert plant.tick == 0
