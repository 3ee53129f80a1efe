"""A reinforcement-learning agent without a model (PPO of stable-baselines3), on a small budget.

It is given every help that costs nothing: orbits and changes stand along the singular vectors of
the known R, every mode divided by its singular value, so that the law to be found is the unit
matrix. It is trained on the ring at the start of the drift, and then stays as it is.

Needs the extra `rl`.
"""

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from stable_baselines3 import PPO

from orbitfb.core.signals import Vector
from orbitfb.evaluate.paper.environment import Environment
from orbitfb.evaluate.paper.scenarios import Scenario

_STEPS = 20_000
_EPISODE = 20
_TRAINING = 1_000_000
"""Trajectories of the training have numbers from here on."""

_AWAY = 4.0
"""An episode ends early when the orbit is this many times as large as the first [1]."""

_CLIP = 10.0
_SMALLEST = 0.1
"""Singular values below this one count as this one [m/rad]."""


class OrbitEnvironment(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """The first ticks of a scenario as an environment of gymnasium.

    An episode begins with a new first orbit; the reward is minus the rms of the true orbit over
    that of the first one. Every observation and action is along the modes of the known R.

    Args:
        scenario: What happens.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._modes = Modes(scenario)
        n, m = scenario.start.shape
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (n,), np.float32)
        self.action_space = gymnasium.spaces.Box(-3.0, 3.0, (min(n, m),), np.float32)
        self._episode = _TRAINING
        self._environment = Environment(scenario, [self._episode])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin with the first orbit of another trajectory."""
        super().reset(seed=seed)
        self._episode += 1
        self._environment = Environment(self._scenario, [self._episode])
        return self._modes.see(self._environment.observe())[0], {}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Apply an action and go on by a tick."""
        environment = self._environment
        environment.step(self._modes.change(action[None]))
        rms = min(float(np.sqrt(np.mean(environment.true**2))), _AWAY * self._scenario.initial)
        away = rms >= _AWAY * self._scenario.initial
        over = environment.tick >= _EPISODE
        observed = self._modes.see(environment.observe())[0]
        return observed, -rms / self._scenario.initial, away, over, {}


class Modes:
    """Orbits and changes along the singular vectors of the R that trajectory 0 starts from."""

    def __init__(self, scenario: Scenario) -> None:
        u, sigma, vt = np.linalg.svd(scenario.known(0), full_matrices=True)
        common = len(sigma)
        self._modes = u / scenario.initial
        self._changes = (vt[:common].T / np.maximum(sigma, _SMALLEST)) * scenario.initial

    def see(self, observed: Vector) -> NDArray[np.float32]:
        """Turn readings (N, n) [m] into what the agent sees [1]."""
        return np.clip(observed @ self._modes, -_CLIP, _CLIP).astype(np.float32)

    def change(self, actions: NDArray[np.float32]) -> Vector:
        """Turn actions (N, k) [1] into changes (N, m) [rad]."""
        return actions.astype(np.float64) @ self._changes.T


class Agent:
    """PPO, trained and then left as it is.

    Args:
        environment: The trajectories.
        device: `auto`, `cpu` or `cuda`.

    Attributes:
        training: What the training came to, as JSON.
    """

    def __init__(self, environment: Environment, device: str) -> None:
        scenario = environment.scenario
        self._modes = Modes(scenario)
        self._agent = PPO(
            "MlpPolicy",
            OrbitEnvironment(scenario),
            learning_rate=3e-4,
            n_steps=1000,
            batch_size=100,
            gamma=0.9,
            policy_kwargs={"log_std_init": -2.0, "net_arch": [256]},
            seed=scenario.seed,
            device=device,
        )
        self._agent.learn(_STEPS)
        rewards = [float(episode["r"]) for episode in self._agent.ep_info_buffer or ()]
        self.training = {
            "figures": {"steps": _STEPS, "reward": float(np.mean(rewards)) if rewards else 0.0},
            "seeds": {"seed": scenario.seed},
        }

    def act(self, observed: Vector, tick: int) -> Vector:
        """Give the changes, shape (N, m) [rad]."""
        actions, _ = self._agent.predict(self._modes.see(observed), deterministic=True)
        return self._modes.change(actions)
