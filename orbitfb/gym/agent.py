"""An agent as a policy: the network that decides, in numpy, without the library that trained it.

Of an agent only its actor is kept, and only as arrays: files of stable-baselines3 hold pickled
objects, which are never opened here.
"""

import hashlib
from collections.abc import Sequence
from functools import cached_property
from typing import Literal

import numpy as np

from orbitfb.core.errors import ConfigError
from orbitfb.core.signals import Mask, Vector
from orbitfb.gym.scaling import Scaling
from orbitfb.policies.infill import Infill

Activation = Literal["tanh", "relu"]
Output = Literal["clip", "tanh"]
Layers = tuple[tuple[Vector, Vector], ...]
"""Weight (out, in) and bias (out,) of every layer, the first one first."""

_PROBE = 1e-6


class AgentPolicy:
    """Correct the orbit by an agent's actor; what it decides is what it decided in training.

    Args:
        layers: Of the actor.
        activation: Between its layers.
        output: What makes actions within ±1 of its last layer.
        scaling: Of the environment that it was trained in.
        policy_id: Its name; by default `agent-` and a hash of the content.

    Raises:
        ConfigError: The layers do not fit together or to the scaling, or are not finite.
    """

    def __init__(
        self,
        layers: Sequence[tuple[Vector, Vector]],
        activation: Activation,
        output: Output,
        scaling: Scaling,
        policy_id: str | None = None,
    ) -> None:
        self.layers: Layers = tuple(
            (np.asarray(weight, dtype=np.float64), np.asarray(bias, dtype=np.float64))
            for weight, bias in layers
        )
        self.activation, self.output, self.scaling = activation, output, scaling
        self.response = scaling.response
        _check(self.layers, scaling)
        self._infill = Infill(self.response)
        self._policy_id = policy_id or f"agent-{self._digest()}"

    @property
    def policy_id(self) -> str:
        """Name under which every record knows it."""
        return self._policy_id

    def initial_state(self) -> None:
        """There is no state."""
        return

    def act(self, error: Vector, valid: Mask, state: None) -> tuple[Vector, None]:
        """Decide.

        Args:
            error: Orbit − reference, shape (n,) [m]; elements that are not valid are ignored.
            valid: BPMs that count, shape (n,).
            state: None.

        Returns:
            The change of setpoints, shape (m,) [A], and no state.
        """
        masked = not valid.all()
        if masked:
            error = self._infill.fill(error, valid)
        change = self.scaling.change(self.decide(self.scaling.see(error)))
        return (self._infill.least(change, valid) if masked else change), None

    def decide(self, observation: np.ndarray) -> Vector:
        """Give the action for an observation, shape (j,) [1]."""
        x = observation.astype(np.float64)
        *hidden, (weight, bias) = self.layers
        for inner, shift in hidden:
            x = inner @ x + shift
            x = np.tanh(x) if self.activation == "tanh" else np.maximum(x, 0.0)
        x = weight @ x + bias
        return np.tanh(x) if self.output == "tanh" else np.clip(x, -1.0, 1.0)

    @cached_property
    def gain_matrix(self) -> Vector:
        """Slope at zero with its sign turned, shape (m, n) [A/m], by central differences."""
        n = self.response.shape[0]
        everyone = np.ones(n, dtype=np.bool_)
        columns = [
            self.act(-_PROBE * unit, everyone, None)[0] - self.act(_PROBE * unit, everyone, None)[0]
            for unit in np.eye(n)
        ]
        return np.array(columns).T / (2 * _PROBE)

    def _digest(self) -> str:
        digest = hashlib.sha256(f"{self.activation} {self.output}".encode())
        for array in (*sum(self.layers, ()), self.scaling.view, self.scaling.move):
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()[:12]


def _check(layers: Layers, scaling: Scaling) -> None:
    width = len(scaling.view)
    for number, (weight, bias) in enumerate(layers, 1):
        if weight.ndim != 2 or weight.shape[1] != width or bias.shape != weight.shape[:1]:
            raise ConfigError(
                f"layer {number} of the agent has matrices of shapes {weight.shape} and "
                f"{bias.shape} for {width} inputs; it is of another environment"
            )
        if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
            raise ConfigError(f"layer {number} of the agent is not finite; train it again")
        width = len(weight)
    if not layers or width != scaling.move.shape[1]:
        raise ConfigError(
            f"the agent gives {width} actions, the environment has {scaling.move.shape[1]}"
        )
