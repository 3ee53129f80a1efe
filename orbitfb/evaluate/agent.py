"""A reinforcement-learning agent beside the laws of this program: same rings, same noise.

The agent is trained on `orbitfb/OrbitFeedback-v0` without a model, and then closes the loop in the
evaluation of `policies compare` like any other policy, on rings that it has not seen.

Training needs the extra `rl`; an agent that is there runs without it.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orbitfb.core.errors import ConfigError
from orbitfb.core.files.state import AS_USUAL
from orbitfb.core.files.whole import replace_file
from orbitfb.core.ports import Policy
from orbitfb.core.signals import Channels, Vector
from orbitfb.evaluate.compare import CompareSettings, Comparison, as_rows, compare
from orbitfb.gym.agent import AgentPolicy
from orbitfb.gym.scaling import Scaling
from orbitfb.learn.builders import first_policy
from orbitfb.measure.packed import read_packed, write_packed
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.settings import PolicySettings

AGENT, REPORT = "agent.safetensors", "agent.json"
_KIND = "agent"
_ADVICE = "train it with `orbitfb evaluate agent`"
_MOST_LAYERS = 16


@dataclass(frozen=True, slots=True)
class AgentResult:
    """An agent, how it was trained, and how it did beside the others.

    Args:
        agent: The agent.
        training: What the training came to; empty when it was read from a file.
        rows: One for each policy.
        settings: What they lived through.
    """

    agent: AgentPolicy
    training: Mapping[str, Any]
    rows: list[Comparison]
    settings: CompareSettings


def evaluate_agent(
    agent: AgentPolicy,
    training: Mapping[str, Any],
    settings: CompareSettings,
    ring: Ring,
    policy: PolicySettings,
    say: Callable[[str], None] = lambda _: None,
) -> AgentResult:
    """Set an agent beside the SVD and the modal law.

    Args:
        agent: The agent.
        training: What its training came to.
        settings: What they live through.
        ring: The ring.
        policy: Settings of the laws.
        say: Told of every policy that begins.
    """
    matrix = response(ring, settings.planes)
    compared: dict[str, Policy] = {"agent": agent}
    for kind in ("svd", "modal"):
        law = policy.model_copy(update={"kind": kind})
        compared[kind] = first_policy(matrix, law, None, lambda _done, _loss: None)
    rows = compare(compared, settings, ring, None, say)
    return AgentResult(agent, training, rows, settings)


def write(result: AgentResult, channels: Channels, out: Path) -> None:
    """Write the agent and the report into a directory."""
    write_agent(out / AGENT, result.agent, channels, result.training)
    report = {
        "schema": 1,
        "agent": result.agent.policy_id,
        "training": result.training,
        "settings": result.settings.model_dump(mode="json"),
        "policies": as_rows(result.rows),
    }
    replace_file(out / REPORT, (json.dumps(report, indent=2) + "\n").encode(), AS_USUAL)


def write_agent(
    path: Path, agent: AgentPolicy, channels: Channels, training: Mapping[str, Any]
) -> None:
    """Write an agent: arrays and a card, nothing pickled.

    Raises:
        MeasurementError: It cannot be written.
    """
    tensors: dict[str, Vector] = {"response": agent.response}
    for number, (weight, bias) in enumerate(agent.layers, 1):
        tensors |= {f"weight_{number}": weight, f"bias_{number}": bias}
    card = {
        "kind": _KIND,
        "id": agent.policy_id,
        "activation": agent.activation,
        "output": agent.output,
        "coordinates": agent.scaling.coordinates,
        "modes": agent.scaling.modes,
        "orbit_scale": agent.scaling.scale,
        "planes": channels.planes,
        "bpms": channels.bpms,
        "correctors": channels.correctors,
        "training": dict(training),
    }
    write_packed(path, tensors, card)


def read_agent(path: Path, channels: Channels) -> tuple[AgentPolicy, dict[str, Any]]:
    """Read an agent and what its training came to.

    Raises:
        ConfigError: It is missing, damaged, or of another ring.
    """
    tensors, card = read_packed(path, _KIND, _ADVICE, ConfigError)
    for key in ("planes", "bpms", "correctors"):
        here = getattr(channels, key)
        if card.get(key) != (here if key == "planes" else list(here)):
            raise ConfigError(f"{path} has other {key} than the configured ring; {_ADVICE}")
    count = (len(tensors) - 1) // 2
    names = {"response"} | {f"{w}_{i}" for w in ("weight", "bias") for i in range(1, count + 1)}
    shape = (len(channels.bpms), len(channels.correctors))
    words = (card.get("activation"), card.get("output"), card.get("coordinates"))
    scale, modes = card.get("orbit_scale"), card.get("modes")
    if (
        not 1 <= count <= _MOST_LAYERS
        or set(tensors) != names
        or tensors["response"].shape != shape
        or not np.isfinite(tensors["response"]).all()
        or words[0] not in ("tanh", "relu")
        or words[1] not in ("clip", "tanh")
        or not isinstance(scale, int | float)
        or not isinstance(modes, int | None)
    ):
        raise ConfigError(f"{path} does not hold an agent of this ring; {_ADVICE}")
    coordinates: Any = words[2]
    scaling = Scaling.of(tensors["response"], coordinates, float(scale), modes)
    layers = [(tensors[f"weight_{i}"], tensors[f"bias_{i}"]) for i in range(1, count + 1)]
    training = card.get("training")
    agent = AgentPolicy(layers, words[0], words[1], scaling, str(card.get("id", "agent"))[:64])
    return agent, training if isinstance(training, dict) else {}
