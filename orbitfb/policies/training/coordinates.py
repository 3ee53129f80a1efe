"""Coordinates in which a network is trained; at export they are multiplied into its matrices.

The response matrix R = U Σ Vᵀ [m/A] spans three decades. A network that maps BPM readings to
corrector changes must learn this spread; one that maps Uᵀe to Σ Vᵀa need only learn −1, because
in these coordinates every mode has the same size. U and V are fixed rotations, so

    a = V Σ⁻¹ · W₄ tanh(W₃ tanh(W₂ tanh(W₁ Uᵀ e)))

is a network of the same shape on the plain readings, with the first matrix W₁Uᵀ and the last
V Σ⁻¹ W₄: nothing of the coordinates is left in the policy that is exported.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Vector

CoordinatesName = Literal["raw", "modes"]
"""`raw`: readings and changes; `modes`: along the singular vectors of the response matrix."""

Matrices = Sequence[NDArray[np.floating[Any]]]
"""Matrices between the layers, each of shape (out, in)."""

_WEAKEST = 1e-6


@dataclass(frozen=True, slots=True)
class Coordinates:
    """Invertible linear maps: x = inward · e [m → 1], a = outward · y [1 → A].

    Args:
        inward: Shape (n, n) [1/m].
        outward: Shape (m, m) [A].
        inward_inverse: Shape (n, n) [m].
        outward_inverse: Shape (m, m) [1/A].
    """

    inward: Vector
    outward: Vector
    inward_inverse: Vector
    outward_inverse: Vector

    @classmethod
    def raw(cls, response: Vector, orbit_scale: float, change_scale: float) -> "Coordinates":
        """Scale readings and changes, nothing else (the paper's form).

        Args:
            response: R, shape (n, m) [m/A]; only its shape counts.
            orbit_scale: What the network sees as 1 [m].
            change_scale: What the network calls 1 [A].
        """
        n, m = response.shape
        return cls(
            np.eye(n) / orbit_scale,
            np.eye(m) * change_scale,
            np.eye(n) * orbit_scale,
            np.eye(m) / change_scale,
        )

    @classmethod
    def modes(cls, response: Vector, orbit_scale: float) -> "Coordinates":
        """Rotate to the modes of a response and divide every mode by its singular value.

        Modes that the response does not have (no sensible inverse) are taken as strong as its
        strongest one, so that the network's first steps hardly drive them.

        Args:
            response: R, shape (n, m) [m/A].
            orbit_scale: What the network sees as 1 [m].
        """
        u, sigma, vt = np.linalg.svd(response, full_matrices=True)
        strength = np.full(response.shape[1], sigma[0])
        strength[: len(sigma)] = np.where(sigma > _WEAKEST * sigma[0], sigma, sigma[0])
        return cls(
            u.T / orbit_scale,
            vt.T * (orbit_scale / strength),
            u * orbit_scale,
            (strength / orbit_scale)[:, None] * vt,
        )

    def outer(self, weights: Matrices, input_scale: float) -> tuple[NDArray[np.float32], ...]:
        """Turn matrices of these coordinates into those of a policy.

        Args:
            weights: Matrices between the layers, inner coordinates; the first takes (n,) and the
                last gives (m,).
            input_scale: By what the policy divides the orbit error before its first matrix [m].

        Returns:
            The policy's matrices, float32; the last gives [A].
        """
        first, *middle, last = (np.asarray(w, dtype=np.float64) for w in weights)
        matrices = (first @ self.inward * input_scale, *middle, self.outward @ last)
        return tuple(np.ascontiguousarray(matrix, dtype=np.float32) for matrix in matrices)

    def inner(self, weights: Matrices, input_scale: float) -> tuple[NDArray[np.float32], ...]:
        """Turn the matrices of a policy into those of these coordinates: `outer` undone."""
        first, *middle, last = (np.asarray(w, dtype=np.float64) for w in weights)
        matrices = (
            first @ self.inward_inverse / input_scale,
            *middle,
            self.outward_inverse @ last,
        )
        return tuple(np.ascontiguousarray(matrix, dtype=np.float32) for matrix in matrices)
