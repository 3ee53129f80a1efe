"""The environment of gymnasium: what its own checks say, seeds, units."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as sb3_check_env

from orbitfb.core.errors import ConfigError
from orbitfb.gym.environment import LOST, PENALTY, OrbitFeedbackEnv
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant, PlantSettings
from orbitfb.physics.response import response

NAME = "orbitfb.gym.register:orbitfb/OrbitFeedback-v0"
R = response(Ring.load(), "x")


@pytest.fixture(scope="module")
def environment():
    return OrbitFeedbackEnv()


def rollout(environment, seed, actions):
    seen = [environment.reset(seed=seed)[0]]
    for action in actions:
        seen.append(environment.step(action)[0])
    return np.array(seen)


@pytest.mark.parametrize("coordinates", ["modes", "devices"])
def test_both_checkers_are_content(coordinates):
    environment = OrbitFeedbackEnv(coordinates=coordinates)
    check_env(environment, skip_render_check=True)
    sb3_check_env(environment)


def test_it_is_made_by_its_name_and_ends_after_20_ticks():
    environment = gymnasium.make(NAME)
    assert isinstance(environment.unwrapped, OrbitFeedbackEnv)
    environment.reset(seed=1)
    still = np.zeros(180, dtype=np.float32)
    ends = [environment.step(still)[2:4] for _ in range(20)]
    assert ends[:-1] == [(False, False)] * 19 and ends[-1] == (False, True)


def test_a_seed_gives_the_same_episodes_and_another_one_others(environment):
    actions = np.random.default_rng(0).uniform(-0.1, 0.1, (5, 180)).astype(np.float32)
    first = rollout(environment, 11, actions)
    assert np.array_equal(first, rollout(OrbitFeedbackEnv(), 11, actions))
    second = environment.reset()[0]  # the next episode of the same seed
    assert not np.array_equal(first[0], second)
    rollout(environment, 11, actions)
    assert np.array_equal(second, environment.reset()[0])
    assert not np.array_equal(first[0], environment.reset(seed=12)[0])


def test_what_is_observed_and_moved_is_the_ring(environment):
    """Beside a plant of its own: units of modes by numpy's own decomposition."""
    plant = Plant(Ring.load(), "x", PlantSettings(), seed=77)
    u, sigma, vt = np.linalg.svd(R)
    seen, _ = environment.reset(seed=1, options={"plant_seed": 77})
    reading = plant.step(np.zeros(180)).reading
    np.testing.assert_allclose(np.abs(seen), np.abs(u.T @ reading) / 250e-6, atol=1e-5)
    action = np.zeros(180, dtype=np.float32)
    action[4] = 1.0
    setpoints = 3 * 250e-6 * vt[4] / sigma[4]
    after, reward, *_ = environment.step(action)
    state = plant.step(setpoints * np.sign(seen[4] * (u[:, 4] @ reading)))
    np.testing.assert_allclose(np.abs(after), np.abs(u.T @ state.reading) / 250e-6, atol=1e-5)
    assert reward == pytest.approx(-np.sqrt(np.mean(state.true_orbit**2)) / 250e-6)


def test_the_obvious_law_corrects_and_a_wrong_one_loses_the_beam(environment):
    seen, figures = environment.reset(seed=3)
    assert figures["true_rms"] > 100e-6
    for _ in range(4):
        seen, reward, lost, _, figures = environment.step(-seen / 3)
    assert figures["true_rms"] < 2e-6 and not lost and reward > -0.01
    for _ in range(20):
        seen, reward, lost, _, figures = environment.step(np.ones(180, dtype=np.float32))
        if lost:
            break
    assert lost and figures["true_rms"] > LOST and reward == -20.0 - PENALTY


def test_few_modes_are_the_strongest(environment):
    few = OrbitFeedbackEnv(modes=8)
    assert few.observation_space.shape == few.action_space.shape == (8,)
    whole, _ = environment.reset(seed=5)
    assert np.array_equal(few.reset(seed=5)[0], whole[:8])
    action = np.linspace(-0.1, 0.1, 8, dtype=np.float32)
    padded = np.concatenate([action, np.zeros(172, dtype=np.float32)])
    assert np.array_equal(few.step(action)[0], environment.step(padded)[0][:8])


def test_settings_reach_the_ring():
    quiet = OrbitFeedbackEnv(
        plant={"initial_orbit_rms": 0.0, "bpm_noise_rms": 0.0, "ground_motion_rms": 0.0},
        effects=["corrector-lag:tau=0.1s"],
        orbit_scale=1e-6,
    )
    assert not quiet.reset(seed=1)[0].any()
    action = np.full(180, 0.01, dtype=np.float32)
    first, second = quiet.step(action)[0], quiet.step(np.zeros(180, dtype=np.float32))[0]
    assert np.abs(second).sum() > 1.2 * np.abs(first).sum(), "the correctors lag"


@pytest.mark.parametrize(
    "wrong",
    [
        {"planes": "z"},
        {"coordinates": "polar"},
        {"plant": {"bpm_noise": 1.0}},
        {"orbit_scale": -1.0},
        {"modes": 0},
        {"modes": 8, "coordinates": "devices"},
        {"render_mode": "human"},
        {"effects": ["no-such-effect"]},
    ],
)
def test_wrong_settings_are_refused(wrong):
    with pytest.raises(ConfigError):
        OrbitFeedbackEnv(**wrong)


def test_wrong_actions_are_refused(environment):
    with pytest.raises(ConfigError, match="reset"):
        OrbitFeedbackEnv().step(np.zeros(180, dtype=np.float32))
    environment.reset(seed=1)
    for action in (np.zeros(179), np.full(180, np.nan)):
        with pytest.raises(ConfigError, match="action"):
            environment.step(action)
