"""Trajectories through a differentiable model, and what they cost: the loss of Algorithm 1.

From first orbits s₀ the policy π and the model f make, for n = 0 … N−1,

    aₙ = π(sₙ + reading noise),     sₙ₊₁ = f(sₙ, aₙ) + motion of the orbit,

and the loss is the mean over trajectories and, weighted with γⁿ, over steps of the cost of
sₙ₊₁. Everything is differentiable, so the gradient of the loss with respect to the policy runs
through the model; there is no value function and no sampling of changes.

Source: Dong, Tian, Sun, Algorithm 1 (cost = rms of the orbit, f linear, no noise).
"""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from orbitfb.core.errors import RingError
from orbitfb.core.signals import Vector
from orbitfb.policies.training.trajectory_settings import RolloutSettings, Stage, stage

Model = Callable[[Tensor, Tensor], Tensor]
"""Next orbits (B, n) [m] from orbits (B, n) [m] and changes (B, m) [A]."""

Draw = Callable[[np.random.Generator], Vector]
"""Response matrices for one iteration, shape (S, n, m) [m/A]."""

ModelAt = Callable[[int], tuple[Model, int]]
"""Model of an iteration, and the number that its batch must be a multiple of."""

_TINY = 1e-30
_DRAWS = 0x6472


class LinearResponses:
    """The model s' = s + R a, for one response matrix or for several at once.

    With S matrices the trajectories are dealt out in S equal groups.

    Args:
        responses: R, shape (n, m) or (S, n, m) [m/A].
        device: Where to compute.
    """

    def __init__(self, responses: Vector, device: torch.device) -> None:
        matrices = np.asarray(responses)
        if matrices.ndim == 2:
            matrices = matrices[None]
        if matrices.ndim != 3 or not np.isfinite(matrices).all():
            raise RingError(
                f"response matrices of shape {np.shape(responses)}, all finite or not, are no "
                "model; finite numbers of shape (n, m) or (samples, n, m) [m/A] are needed"
            )
        self.count = len(matrices)
        transposed = np.ascontiguousarray(np.swapaxes(matrices, 1, 2), dtype=np.float32)
        self._transposed = torch.from_numpy(transposed).to(device)

    def __call__(self, orbit: Tensor, change: Tensor) -> Tensor:
        """Give the next orbits, shape (B, n) [m]; B is a multiple of the number of matrices."""
        if self.count == 1:
            return torch.addmm(orbit, change, self._transposed[0])
        groups = (self.count, -1)
        moved = torch.bmm(change.view(*groups, change.shape[1]), self._transposed)
        return orbit + moved.view(orbit.shape)


class TrajectoryLoss:
    """The loss of an iteration, ready for `nets.training.train`.

    Args:
        law: Policy in training: changes (B, m) [A] from readings (B, n) [m].
        model_at: Model of an iteration, and by what number its batch must be divisible.
        response: R for the motion by kicks, shape (n, m) [m/A].
        settings: Trajectories and their cost.
        iterations: Iterations in all, for the curriculum.
        generator: Random numbers, on the CPU.
        device: Where to compute.
    """

    def __init__(
        self,
        law: Callable[[Tensor], Tensor],
        model_at: ModelAt,
        response: Vector,
        settings: RolloutSettings,
        iterations: int,
        generator: torch.Generator,
        device: torch.device,
    ) -> None:
        self._law, self._model_at, self._settings = law, model_at, settings
        self._iterations, self._generator, self._device = iterations, generator, device
        self._size, self._changes = response.shape
        per_ampere = np.linalg.norm(response) / np.sqrt(self._size)
        self._kick = settings.kick_noise / per_ampere if per_ampere > 0.0 else 0.0
        self._response = LinearResponses(response, device)

    def __call__(self, iteration: int) -> Tensor:
        """Give the loss at an iteration, a scalar tensor [1]."""
        settings = self._settings
        now = stage(settings, iteration, self._iterations)
        model, groups = self._model_at(iteration)
        batch = max(settings.batch // groups, 1) * groups
        orbit = self._first_orbits(now, batch)
        first = _rms(orbit) if settings.loss == "relative" else None
        summed = torch.zeros(batch, self._changes, device=self._device)
        loss, weight, weights = torch.zeros((), device=self._device), 1.0, 0.0
        for _ in range(now.horizon):
            change = self._law(self._read(orbit))
            orbit = self._move(model(orbit, change))
            price = _rms(orbit)
            if settings.change_cost > 0.0:
                price = price + settings.change_cost * _rms(change)
            if settings.setpoint_cost > 0.0:
                summed = summed + change
                price = price + settings.setpoint_cost * _rms(summed)
            loss = loss + weight * self._cost(price, first)
            weights += weight
            weight *= settings.discount
        return loss / weights

    def _cost(self, price: Tensor, first: Tensor | None) -> Tensor:
        """Turn orbit rms (with its additions), shape (B,) [m], into the mean cost [1]."""
        settings = self._settings
        if first is not None:
            return torch.mean(price / first)
        relative = price / settings.amplitude
        if settings.loss == "log":
            floor = (settings.log_floor / settings.amplitude) ** 2
            return 0.5 * torch.mean(torch.log(relative**2 + floor))
        return torch.mean(relative)

    def _first_orbits(self, now: Stage, batch: int) -> Tensor:
        white = self._normal(batch, self._size)
        if now.smallest == now.largest:
            return now.largest * white
        share = torch.rand(batch, 1, generator=self._generator).to(self._device)
        return now.largest * (now.smallest / now.largest) ** share * white

    def _read(self, orbit: Tensor) -> Tensor:
        noise = self._settings.reading_noise
        return orbit + noise * self._normal(*orbit.shape) if noise > 0.0 else orbit

    def _move(self, orbit: Tensor) -> Tensor:
        if self._settings.orbit_noise > 0.0:
            orbit = orbit + self._settings.orbit_noise * self._normal(*orbit.shape)
        if self._kick > 0.0:
            orbit = self._response(orbit, self._kick * self._normal(len(orbit), self._changes))
        return orbit

    def _normal(self, *shape: int) -> Tensor:
        # Drawn on the CPU whatever the device, so that a seed means the same everywhere.
        return torch.randn(*shape, generator=self._generator).to(self._device)


def drawn(
    draw: Draw | None, fixed: Model, settings: RolloutSettings, seed: int, device: torch.device
) -> ModelAt:
    """Give the model of every iteration: the fixed one, or responses drawn anew.

    What is drawn depends on seed and iteration alone, so a resumed training sees the same.
    """

    def model_at(iteration: int) -> tuple[Model, int]:
        if draw is None:
            return fixed, 1
        rng = np.random.default_rng([seed, iteration, _DRAWS])
        responses = LinearResponses(draw(rng)[: settings.batch], device)
        return responses, responses.count

    return model_at


def _rms(vectors: Tensor) -> Tensor:
    """Root of the mean square along the last axis; differentiable at zero."""
    return torch.sqrt(torch.mean(vectors**2, dim=-1) + _TINY)


def learning_rate(first: float, final: float | None, iterations: int) -> Callable[[int], float]:
    """Give the learning rate at an iteration: constant, or along half a cosine to `final`."""

    def rate(iteration: int) -> float:
        if final is None:
            return first
        progress = iteration / max(iterations - 1, 1)
        return final + (first - final) * 0.5 * (1.0 + float(np.cos(np.pi * progress)))

    return rate
