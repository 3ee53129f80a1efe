"""The paper's forward net f(s, a) → s' − s as a model of the ring, an ensemble of them.

    s' = s + R̂ a + U diag(c) · mean over the members of net([Uᵀ s / b, Vᵀ a / d])

U and V are the singular vectors of R̂, so that every direction enters and leaves with the size 1
that it had in training (micrometres and milliamperes are neither), b and d the rms of orbit and
change along them, c that of the innovations. Without the residual form R̂ a is absent. The nets
have no bias: where nothing is changed at a perfect orbit, nothing moves.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray

from orbitfb.core.signals import Vector

Weights = tuple[NDArray[np.float32], ...]
"""Matrices of one net from the first layer to the last, each of shape (out, in)."""

TorchStep = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
"""Next orbit (B, n) [m] of an orbit (B, n) [m] and a change (B, m) [A]."""


@dataclass(frozen=True, slots=True)
class Coordinates:
    """Where the nets live.

    Args:
        modes: U, shape (n, n).
        directions: V, shape (m, m).
        orbit: b, shape (n,) [m].
        change: d, shape (m,) [A].
        answer: c, shape (n,) [m].
    """

    modes: Vector
    directions: Vector
    orbit: Vector
    change: Vector
    answer: Vector

    def inputs(self, orbit: Vector, change: Vector) -> Vector:
        """Give what a net reads, shape (..., n + m), of orbits (..., n) [m] and changes [A]."""
        parts = (orbit @ self.modes / self.orbit, change @ self.directions / self.change)
        return np.concatenate(parts, axis=-1)


@dataclass(frozen=True, slots=True)
class ForwardNet:
    """An ensemble of forward nets.

    Args:
        response: R̂ [m/A] of the residual form, shape (n, m); zeros without it.
        coordinates: Where the nets live.
        members: Weights of every net.
        figures: What the validation found, SI.
        curve: Loss at every iteration of the training [1].
    """

    response: Vector
    coordinates: Coordinates
    members: tuple[Weights, ...]
    figures: Mapping[str, float] = field(default_factory=dict)
    curve: Sequence[float] = ()

    def difference(self, orbit: Vector, change: Vector) -> Vector:
        """Predict s' − s, shape (..., n) [m], of orbits (..., n) [m] and changes (..., m) [A]."""
        answers = self._answers(orbit, change)
        return change @ self.response.T + answers.mean(axis=0)

    def predict(self, orbit: Vector, change: Vector) -> Vector:
        """Predict the next orbit, shape (..., n) [m], of orbits [m] and changes (..., m) [A]."""
        return orbit + self.difference(orbit, change)

    def uncertainty(self, orbit: Vector, change: Vector) -> Vector:
        """Spread of the members' predictions, shape (..., n) [m]; zero for a single one."""
        answers = self._answers(orbit, change)
        if len(answers) < 2:
            return np.zeros(answers.shape[1:])
        return answers.std(axis=0, ddof=1)

    def slope(self) -> Vector:
        """Give the response at a perfect orbit, ∂s'/∂a, shape (n, m) [m/A]."""
        at = self.coordinates
        inner = np.mean([_slope(weights) for weights in self.members], axis=0)
        inner = inner[:, len(at.orbit) :] / at.change
        return self.response + at.modes @ (at.answer[:, None] * inner) @ at.directions.T

    def torch_step(self, device: torch.device | None = None) -> TorchStep:
        """Give the model to a policy's training, differentiable, in float32.

        Args:
            device: Where the tensors live; None: on the CPU.
        """
        at = self.coordinates

        def tensor(array: Vector | NDArray[np.float32]) -> torch.Tensor:
            return torch.as_tensor(np.ascontiguousarray(array), dtype=torch.float32, device=device)

        read_orbit = tensor((at.modes / at.orbit).T)
        read_change = tensor((at.directions / at.change).T)
        response, write = tensor(self.response), tensor(at.modes * at.answer)
        members = [[tensor(weight) for weight in weights] for weights in self.members]
        linear = torch.nn.functional.linear

        def step(state: torch.Tensor, change: torch.Tensor) -> torch.Tensor:
            inputs = torch.cat([linear(state, read_orbit), linear(change, read_change)], dim=-1)
            answer = torch.zeros_like(state)
            for *hidden, last in members:
                x = inputs
                for weight in hidden:
                    x = torch.tanh(linear(x, weight))
                answer = answer + linear(x, last)
            return state + linear(change, response) + linear(answer / len(members), write)

        return step

    def _answers(self, orbit: Vector, change: Vector) -> Vector:
        """What each net adds, shape (members, ..., n) [m]."""
        at = self.coordinates
        inputs = at.inputs(np.asarray(orbit, np.float64), np.asarray(change, np.float64))
        answers = []
        for *hidden, last in self.members:
            x = inputs
            for weight in hidden:
                x = np.tanh(x @ weight.T)
            answers.append((x @ last.T * at.answer) @ at.modes.T)
        return np.array(answers)


def _slope(weights: Weights) -> Vector:
    """Derivative of a net at zero: tanh has the slope 1 there."""
    product = weights[0].astype(np.float64)
    for weight in weights[1:]:
        product = weight @ product
    return product
