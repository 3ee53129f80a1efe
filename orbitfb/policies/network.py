"""The paper's network as a policy: n–h–h–h–m, tanh, no bias, in numpy and single precision.

    a = W₄ tanh(W₃ tanh(W₂ tanh(W₁ e / s)))

with the orbit error e [m] divided by a scale s, so that tanh works where the loop lives, and
the last matrix giving [A]. Without biases a zero orbit error changes nothing. The hidden width
follows the ring: h = ⌈512 n / 180⌉, the paper's 512 for 180 BPMs.

Single precision is relative: what it costs scales with the orbit, whether that is 1 mm or 0.1 µm.
The change that corrects an orbit is exact to about 10⁻⁷ of itself; the orbit that is left is
disturbed by that times the condition number of what the last matrix inverts, 4 · 10⁻⁵ of the
orbit before on the default ring without regularisation (8 pm at 0.2 µm).

Source: the policy network of the paper; how a network is made from a law that is known is in
`policies.embedding`, how one is trained in `policies.training.supervised` and
`policies.training.trajectory`.
"""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from orbitfb.core.errors import ConfigError, RingError
from orbitfb.core.settings import Settings
from orbitfb.core.signals import Mask, Vector
from orbitfb.policies.infill import NOISY, Infill
from orbitfb.policies.inverse import checked_response, content_hash, frozen

Weights = tuple[NDArray[np.float32], ...]
"""Matrices from the first layer to the last, each of shape (out, in)."""

LAYERS = 4
_PAPER_WIDTH, _PAPER_BPMS = 512, 180


class NetworkSettings(Settings):
    """Configuration of a network policy."""

    input_scale: float = Field(
        default=250e-6, gt=0.0, description="By what the orbit error is divided, s [m]."
    )


class NetworkPolicy:
    """Correct the orbit error by a network; the weights are read-only, so threads can share it.

    Masked BPMs are filled in by what the valid ones let expect (`policies.infill`).

    Args:
        weights: W₁ (h, n), W₂ (h, h), W₃ (h, h), W₄ (m, h) [A]; single precision. What is
            read-only already is not copied.
        response: R that it was made for, shape (n, m) [m/A].
        settings: The scale of its input.
        policy_id: Its name; by default `network-` and a hash of the content.

    Raises:
        RingError: The matrices do not fit together or to the response, or are not finite.
    """

    def __init__(
        self,
        weights: Sequence[NDArray[np.float32]],
        response: Vector,
        settings: NetworkSettings | None = None,
        policy_id: str | None = None,
    ) -> None:
        self.response = checked_response(response)
        self.settings = settings or NetworkSettings()
        self.weights = _checked_weights(weights, self.response)
        self._policy_id = policy_id or "network-" + content_hash(
            self.settings, self.response, *self.weights
        )
        self._per_scale = 1.0 / self.settings.input_scale
        self._layers, self._last = _without_zeros(self.weights)
        self._infill = Infill(self.response, NOISY)

    @property
    def policy_id(self) -> str:
        """Name under which the store and every record know it."""
        return self._policy_id

    @property
    def parameters(self) -> int:
        """Count of the weights."""
        return sum(weight.size for weight in self.weights)

    @cached_property
    def gain_matrix(self) -> Vector:
        """Slope at zero with its sign turned, −W₄ W₃ W₂ W₁ / s, shape (m, n) [A/m]."""
        first, second, third, last = (weight.astype(np.float64) for weight in self.weights)
        return frozen(-self._per_scale * (last @ third) @ (second @ first))

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
        masked = np.count_nonzero(valid) < len(error)  # faster than valid.all()
        if masked:
            error = self._infill.fill(error, valid)
        x = (self._per_scale * error).astype(np.float32)
        for layer in self._layers:
            x = layer * x if layer.ndim == 1 else layer @ x
            np.tanh(x, out=x)
        change = (self._last @ x).astype(np.float64)
        return (self._infill.least(change, valid) if masked else change), None

    def changes(self, errors: Vector) -> Vector:
        """Decide on many orbits at once, all BPMs valid.

        Args:
            errors: Orbit − reference, shape (..., n) [m].

        Returns:
            The changes of setpoints, shape (..., m) [A].
        """
        x = (self._per_scale * errors).astype(np.float32)
        for layer in self._layers:
            x = x * layer if layer.ndim == 1 else x @ layer.T
            np.tanh(x, out=x)
        return (x @ self._last.T).astype(np.float64)


def hidden_width(bpms: int) -> int:
    """Give the width of the hidden layers for a ring: the paper's, in proportion to the BPMs."""
    return -(-_PAPER_WIDTH * bpms // _PAPER_BPMS)


def network_sizes(bpms: int, correctors: int) -> tuple[int, ...]:
    """Give the widths of all layers of the policy of a ring, n, h, h, h, m."""
    width = hidden_width(bpms)
    return (bpms, width, width, width, correctors)


def _checked_weights(weights: Sequence[NDArray[np.float32]], response: Vector) -> Weights:
    if len(weights) != LAYERS:
        raise ConfigError(f"a policy network has {LAYERS} matrices, not {len(weights)}")
    checked = tuple(_single(weight) for weight in weights)
    shapes = [weight.shape for weight in checked]
    n, m = response.shape
    ends = [shape[0] for shape in shapes if len(shape) == 2]
    if shapes != list(zip(ends, [n, *ends[:-1]], strict=False)) or ends[-1] != m:
        raise RingError(
            f"matrices of shapes {shapes} make no network from {n} BPMs to {m} correctors"
        )
    for number, weight in enumerate(checked, 1):
        if not np.isfinite(weight).all():
            raise RingError(f"matrix {number} of the network is not finite; train it again")
    return checked


def _without_zeros(weights: Weights) -> tuple[Weights, NDArray[np.float32]]:
    """Leave out what is zero in the hidden layers: an embedded law is mostly that.

    A hidden matrix that is diagonal becomes a vector, and if all are, units that carry nothing
    are left out. The result is the same and costs a small part of the time.

    Returns:
        The hidden layers, matrices or vectors, and the last matrix.
    """
    first, *middle, last = weights
    diagonals = [np.diag(weight).copy() for weight in middle]
    layers = [
        diagonal if _is_diagonal(weight) else weight
        for weight, diagonal in zip(middle, diagonals, strict=True)
    ]
    if any(layer.ndim == 2 for layer in layers):
        return (first, *layers), last
    carrying = first.any(axis=1) & last.any(axis=0) & np.all(diagonals, axis=0)
    return (first[carrying], *(layer[carrying] for layer in layers)), last[:, carrying].copy()


def _is_diagonal(weight: NDArray[np.float32]) -> bool:
    square = weight.shape[0] == weight.shape[1]
    return square and np.count_nonzero(weight) == np.count_nonzero(np.diag(weight))


def _single(weight: NDArray[np.float32]) -> NDArray[np.float32]:
    if weight.dtype == np.float32 and weight.flags.c_contiguous and not weight.flags.writeable:
        return weight
    copy = np.array(weight, dtype=np.float32, order="C")
    copy.setflags(write=False)
    return copy
