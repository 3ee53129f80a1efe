"""Train an agent of stable-baselines3 on the environment, and take its actor out as a policy.

Needs the extra `rl`.
"""

import itertools
from collections.abc import Callable
from typing import Any, Literal

import gymnasium
import numpy as np
import torch
from pydantic import Field
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.monitor import Monitor

from orbitfb.core.errors import TrainingError
from orbitfb.core.settings import Settings
from orbitfb.gym.agent import AgentPolicy
from orbitfb.gym.environment import OrbitFeedbackEnv
from orbitfb.gym.register import EPISODE
from orbitfb.gym.scaling import Coordinates

_ALGORITHMS: dict[str, type[BaseAlgorithm]] = {"ppo": PPO, "sac": SAC, "td3": TD3}
_ACTIVATIONS: dict[type[torch.nn.Module], Any] = {torch.nn.Tanh: "tanh", torch.nn.ReLU: "relu"}
_TOLD = 20


class AgentSettings(Settings):
    """How an agent is trained."""

    algorithm: Literal["ppo", "sac", "td3"] = Field(
        default="ppo", description="Algorithm of stable-baselines3."
    )
    steps: int = Field(default=20_000, ge=100, le=100_000_000, description="Ticks it learns from.")
    coordinates: Coordinates = Field(
        default="modes",
        description="What it sees and moves: the modes of the known R, or devices.",
    )
    modes: int | None = Field(
        default=8,
        ge=1,
        description="The strongest modes that it sees and moves; none: all of them, or devices.",
    )
    discount: float = Field(
        default=0.9, gt=0.0, lt=1.0, description="What a reward one tick later is worth [1]."
    )
    learning_rate: float = Field(default=3e-4, gt=0.0, description="Step of the optimiser [1].")
    width: int = Field(default=64, ge=1, le=8192, description="Units of its hidden layer.")
    seed: int = Field(default=0, ge=0, description="Of weights, exploration and rings.")
    device: Literal["auto", "cpu", "cuda"] = Field(
        default="cpu", description="Where it learns; networks of this size are no faster on a GPU."
    )


class _Told(BaseCallback):
    """Says how far it is, and keeps the mean reward of the episodes that have ended."""

    def __init__(self, steps: int, say: Callable[[str], None]) -> None:
        super().__init__()
        self._every, self._steps, self._say = max(1, steps // _TOLD), steps, say
        self.curve: list[tuple[int, float]] = []

    def _on_step(self) -> bool:
        if self.num_timesteps // self._every > len(self.curve):
            episodes = self.model.ep_info_buffer or ()
            mean = float(np.mean([each["r"] for each in episodes])) if episodes else float("nan")
            self.curve.append((self.num_timesteps, mean))
            self._say(f"{self.num_timesteps} of {self._steps} steps, reward {mean:.4g} an episode")
        return True


def train_agent(
    environment: OrbitFeedbackEnv,
    settings: AgentSettings,
    say: Callable[[str], None] = lambda _: None,
) -> tuple[AgentPolicy, dict[str, Any]]:
    """Train an agent.

    Args:
        environment: What it learns on.
        settings: How.
        say: Told how far it is.

    Returns:
        The policy, and what the training came to, as JSON.

    Raises:
        TrainingError: What came out is not finite.
    """
    episodes = Monitor(gymnasium.wrappers.TimeLimit(environment, EPISODE))
    arguments: dict[str, Any] = {
        "learning_rate": settings.learning_rate,
        "gamma": settings.discount,
        "seed": settings.seed,
        "device": settings.device,
        "policy_kwargs": {"net_arch": [settings.width], "activation_fn": torch.nn.Tanh},
    }
    if settings.algorithm == "ppo":
        arguments |= {"n_steps": min(1000, settings.steps // 100 * 100), "batch_size": 100}
        arguments["policy_kwargs"]["log_std_init"] = -2.0
    model = _ALGORITHMS[settings.algorithm]("MlpPolicy", episodes, **arguments)
    told = _Told(settings.steps, say)
    try:
        model.learn(settings.steps, callback=told)
    except ValueError as error:  # stable-baselines3 over weights that are no numbers any more
        raise TrainingError(
            f"the agent diverged ({str(error)[:100]}); lower the learning rate"
        ) from error
    finite = [[steps, reward] for steps, reward in told.curve if np.isfinite(reward)]
    training = {"settings": settings.model_dump(mode="json"), "reward_per_episode": finite}
    return policy_of(model, environment), training


def policy_of(model: BaseAlgorithm, environment: OrbitFeedbackEnv) -> AgentPolicy:
    """Take the actor of an agent that was trained on the environment, without its exploration.

    Args:
        model: A PPO, SAC or TD3 of stable-baselines3 with an MlpPolicy.
        environment: What it was trained on.

    Raises:
        TrainingError: It is of another kind, or what it is made of is not known.
    """
    policy: Any = model.policy
    if isinstance(model, PPO):
        parts, output = [*policy.mlp_extractor.policy_net, policy.action_net], "clip"
    elif isinstance(model, SAC):
        parts, output = [*policy.actor.latent_pi, policy.actor.mu], "tanh"
    elif isinstance(model, TD3):
        *parts, _last = policy.actor.mu  # its last one is a tanh
        output = "tanh"
    else:
        raise TrainingError(f"agents of {type(model).__name__} are not known; use PPO, SAC or TD3")
    linear = [part for part in parts if isinstance(part, torch.nn.Linear)]
    between = {type(part) for part in parts if not isinstance(part, torch.nn.Linear)}
    alternating = all(
        isinstance(part, torch.nn.Linear) == (place % 2 == 0) for place, part in enumerate(parts)
    )
    if not alternating or len(between) > 1 or not between <= set(_ACTIVATIONS):
        raise TrainingError(
            "the actor is not made of linear layers with tanh or ReLU between them: "
            f"{', '.join(type(part).__name__ for part in parts)}"
        )
    layers = [
        (part.weight.detach().cpu().numpy(), part.bias.detach().cpu().numpy()) for part in linear
    ]
    if not all(np.isfinite(array).all() for array in itertools.chain(*layers)):
        raise TrainingError("the agent is not finite; lower the learning rate and train it again")
    activation = _ACTIVATIONS[between.pop()] if between else "tanh"
    return AgentPolicy(layers, activation, output, environment.scaling)
