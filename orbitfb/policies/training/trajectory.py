"""Algorithm 1: a policy network, trained by the gradient through trajectories of a model.

The paper's network π(e) is put in closed loop with a differentiable model of the ring, the
cost of a trajectory (`policies.training.rollout`) is differentiated through all its steps, and Adam
takes a step. In the paper's plain form (`TrajectorySettings.paper()`) the network maps readings
to changes, starts at random and minimises the rms of the orbit: it must find out by itself that
the modes of the ring differ in strength by three decades, and does so one decade after the
other. The options take that away, one by one:

- *coordinates* `modes`: the fixed rotations and singular values of R stand before and behind
  the network in training, and are multiplied into its first and last matrix at the end;
- *loss* `relative` or `log` with *amplitudes* over decades: the floor counts as much as the
  capture, where the plain rms sees only the largest orbits;
- *start*: the weights of an incumbent (warm start), or a known law embedded into the network;
- *trained*: only a part of the weights, so that a precise start is not destroyed by steps of
  Adam of which each moves all weights by about the learning rate;
- *draw*: other response matrices in every iteration, so that the policy holds for all of them;
- reading noise and motion of the orbit in the trajectories; curricula of horizon and amplitude.

Source: Dong, Tian, Sun, Algorithm 1.
"""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from orbitfb.core.errors import ConfigError
from orbitfb.core.signals import Vector
from orbitfb.nets.checkpoint import Checkpoint
from orbitfb.nets.device import pick_device
from orbitfb.nets.perceptron import Perceptron
from orbitfb.nets.training import Progress, train
from orbitfb.policies.inverse import checked_response, content_hash
from orbitfb.policies.network import NetworkPolicy, NetworkSettings, hidden_width
from orbitfb.policies.training.coordinates import Coordinates
from orbitfb.policies.training.rehearsal import spectral_radius
from orbitfb.policies.training.result import TrainingResult
from orbitfb.policies.training.rollout import (
    Draw,
    LinearResponses,
    Model,
    ModelAt,
    TrajectoryLoss,
    drawn,
    learning_rate,
)
from orbitfb.policies.training.trajectory_settings import NetworkDescentSettings, TrajectorySettings


def train_trajectory(
    response: Vector,
    settings: TrajectorySettings,
    *,
    start: NetworkPolicy | None = None,
    model: Model | None = None,
    draw: Draw | None = None,
    device: str = "auto",
    progress: Progress | None = None,
    checkpoint: Path | None = None,
) -> TrainingResult[NetworkPolicy]:
    """Train a network through the system model.

    Args:
        response: R, shape (n, m) [m/A]: the model, unless another one is given, and always what
            the coordinates are made from.
        settings: Trajectories, loss, form of the network, optimiser.
        start: Network to begin with, an incumbent or an embedded law; None: at random.
        model: Another model: next orbits (B, n) [m] from orbits (B, n) [m] and changes (B, m) [A],
            differentiable torch on the same device.
        draw: Gives the response matrices of an iteration, shape (S, n, m) [m/A], in place of R.
        device: `auto`, `cpu` or `cuda`.
        progress: Told after every iteration.
        checkpoint: Directory to keep the training in, and to resume it from.

    Returns:
        The network on plain readings and its figures: `spectral_radius` on R [1], `seconds`,
        `seconds_per_iteration`, `loss` of the last iteration [1].

    Raises:
        ConfigError: Options that exclude each other, or a GPU that is not there.
        RingError: A response matrix that makes no sense, or a start of another ring.
        TrainingError: Loss or gradient are not finite; the message says what may help.
    """
    response = checked_response(response)
    target = pick_device(device)
    if model is not None and draw is not None:
        raise ConfigError("give either a model or a draw of response matrices, not both")
    network = build(response, settings, start, settings.hidden, settings.first_output).to(target)
    fixed = model or LinearResponses(response, target)
    model_at = drawn(draw, fixed, settings, settings.seed, target)
    purpose = {
        "settings": settings.model_dump(mode="json"),
        "response": content_hash(settings, response),
        "start": None if start is None else content_hash(start.settings, *start.weights),
    }
    kept = None if checkpoint is None else Checkpoint(checkpoint, purpose)
    began = time.perf_counter()
    curve = descend(network, model_at, response, settings, target, progress, kept)
    seconds = time.perf_counter() - began
    policy = network.export(response)
    figures = {
        "spectral_radius": spectral_radius(policy.gain_matrix, response),
        "seconds": seconds,
        "seconds_per_iteration": seconds / max(len(curve), 1),
        "loss": curve[-1] if curve else float("nan"),
    }
    return TrainingResult(
        policy=policy,
        method="trajectory",
        settings=settings.model_dump(mode="json"),
        seeds={"seed": settings.seed},
        curve=tuple(curve),
        figures=figures,
    )


class NetworkInTraining(torch.nn.Module):
    """A network between fixed coordinates; what is not trained is held.

    Args:
        perceptron: The network on the inner coordinates.
        coordinates: Coordinates around it.
        settings: What is trained.
        spare: Units of each hidden layer that may be trained; None: all.
    """

    def __init__(
        self,
        perceptron: Perceptron,
        coordinates: Coordinates,
        settings: NetworkDescentSettings,
        spare: Sequence[NDArray[np.bool_]] | None = None,
    ) -> None:
        super().__init__()
        self.perceptron, self._coordinates = perceptron, coordinates
        self._input_scale = settings.orbit_scale
        self.register_buffer("inward", _single(coordinates.inward), persistent=False)
        self.register_buffer("outward", _single(coordinates.outward), persistent=False)
        self.mixing: torch.nn.Parameter | None = None
        if settings.trained == "output":
            size = perceptron.sizes[-1]
            self.mixing = torch.nn.Parameter(torch.zeros(size, size))
        last = len(perceptron.weights) - 1
        for index, weight in enumerate(perceptron.weights):
            free = settings.trained in ("all", "spare") or (
                settings.trained == "last" and index == last
            )
            weight.requires_grad_(free)
        if spare is not None:
            _hold_used(perceptron, spare)

    def forward(self, reading: Tensor) -> Tensor:
        """Give changes, shape (B, m) [A], for readings of shape (B, n) [m]."""
        y = self.perceptron(torch.nn.functional.linear(reading, self.get_buffer("inward")))
        if self.mixing is not None:
            y = y + torch.nn.functional.linear(y, self.mixing)
        return torch.nn.functional.linear(y, self.get_buffer("outward"))

    def export(self, response: Vector, policy_id: str | None = None) -> NetworkPolicy:
        """Multiply everything into the matrices of a policy of the plain readings."""
        weights: list[NDArray[np.floating[Any]]] = [*self.perceptron.arrays()]
        if self.mixing is not None:
            mixing = self.mixing.detach().cpu().numpy().astype(np.float64)
            weights[-1] = weights[-1] + mixing @ weights[-1]
        matrices = self._coordinates.outer(weights, self._input_scale)
        settings = NetworkSettings(input_scale=self._input_scale)
        return NetworkPolicy(matrices, response, settings, policy_id)


def build(
    response: Vector,
    settings: NetworkDescentSettings,
    start: NetworkPolicy | None,
    hidden: int | None = None,
    first_output: float = 1.0,
) -> NetworkInTraining:
    """Put a network, random or given, between the coordinates of a response.

    Args:
        response: R, shape (n, m) [m/A].
        settings: Coordinates, and what is trained.
        start: The network to begin with; None: at random.
        hidden: Units per hidden layer; None: as the paper, or as the start.
        first_output: Factor on the last matrix of a random network [1].

    Raises:
        ConfigError: `hidden` differs from the start's, or what is trained needs a start.
    """
    n, m = response.shape
    if settings.coordinates == "modes":
        coordinates = Coordinates.modes(response, settings.orbit_scale)
    else:
        coordinates = Coordinates.raw(response, settings.orbit_scale, settings.change_scale)
    if start is None:
        if settings.trained != "all":
            raise ConfigError(
                f"trained is {settings.trained!r}, but there is no network to start from: the "
                "rest would stay random; give a start, or train all"
            )
        width = hidden or hidden_width(n)
        sizes = (n, width, width, width, m)
        perceptron = Perceptron(sizes, settings.seed, settings.output_scale)
        with torch.no_grad():
            perceptron.weights[-1] *= first_output
        return NetworkInTraining(perceptron, coordinates, settings)
    sizes = (n, *(len(weight) for weight in start.weights))
    if start.response.shape != (n, m):
        raise ConfigError(
            f"the start is a network for {start.response.shape} (BPMs, correctors), the response "
            f"matrix has {(n, m)}; give one of the same ring"
        )
    if hidden is not None and any(size != hidden for size in sizes[1:-1]):
        raise ConfigError(
            f"hidden is {hidden}, the start has layers of {sizes[1:-1]} units; leave it unset"
        )
    perceptron = Perceptron(sizes, settings.seed, settings.output_scale)
    spare = None
    weights = coordinates.inner(start.weights, start.settings.input_scale)
    if settings.trained == "spare":
        spare = [~np.any(weight, axis=1) for weight in start.weights[:-1]]
        weights = tuple(_seeded(weights, perceptron, spare))
    perceptron.load_arrays(weights)
    return NetworkInTraining(perceptron, coordinates, settings, spare)


def descend(
    network: NetworkInTraining,
    model_at: ModelAt,
    response: Vector,
    settings: NetworkDescentSettings,
    device: torch.device,
    progress: Progress | None = None,
    checkpoint: Checkpoint | None = None,
) -> list[float]:
    """Train a network in place and return the loss at every iteration [1]."""
    generator = torch.Generator().manual_seed(settings.seed)
    loss = TrajectoryLoss(
        network, model_at, response, settings, settings.iterations, generator, device
    )
    return train(
        {"network": network},
        loss,
        iterations=settings.iterations,
        learning_rate=learning_rate(
            settings.learning_rate, settings.final_learning_rate, settings.iterations
        ),
        generator=generator,
        clip=settings.clip,
        progress=progress,
        checkpoint=checkpoint,
    )


def _seeded(
    weights: Sequence[NDArray[np.float32]],
    perceptron: Perceptron,
    spare: Sequence[NDArray[np.bool_]],
) -> list[NDArray[np.float32]]:
    """Let unused units begin at random; their outputs count nothing until they are trained."""
    if not all(units.any() for units in spare):
        raise ConfigError(
            "trained is 'spare', but a hidden layer of the start has no unit to spare; train "
            "'output' instead, or start from a wider network"
        )
    mixed = [weight.copy() for weight in weights]
    for weight, units, random in zip(mixed, spare, perceptron.arrays(), strict=False):
        weight[units] = random[units]
    mixed[-1][:, spare[-1]] = 0.0
    return mixed


def _hold_used(perceptron: Perceptron, spare: Sequence[NDArray[np.bool_]]) -> None:
    """Let the gradient reach what comes into and goes out of spare units, and nothing else."""
    for index, weight in enumerate(perceptron.weights):
        mask = torch.zeros_like(weight)
        if index < len(spare):
            mask[torch.from_numpy(spare[index])] = 1.0
        else:
            mask[:, torch.from_numpy(spare[-1])] = 1.0
        perceptron.register_buffer(f"free{index}", mask, persistent=False)
        weight.register_hook(
            lambda gradient, name=f"free{index}": gradient * perceptron.get_buffer(name)
        )


def _single(matrix: Vector) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(matrix, dtype=np.float32))
