"""The paper's network with one gain near zero and another far from it: nothing is trained.

    a = −K_far U z + (K_far − K_near) U δ tanh(z / δ),     z = Uᵀ e:

the slope is K_near where |z_i| ≪ δ_i, and K_far where |z_i| ≫ δ_i. The hidden layers are those of
`policies.embedding`; they hold U and δ and stay as they are. Both gains are in the last matrix,
[−K_far U s/α, (K_far − K_near) U δ/α], so that an adaptive loop swaps it alone, for the price of
two products of matrices.
"""

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Vector
from orbitfb.policies.embedding import LINEAR_RANGE, embed
from orbitfb.policies.modal import ModalPolicy, ModalSettings
from orbitfb.policies.network import NetworkPolicy, NetworkSettings


class TwoScaleNetwork:
    """Hidden layers that are embedded once, and the last matrix for any pair of gains.

    Args:
        response: R to begin with, shape (n, m) [m/A].
        modes: U, orthonormal, shape (n, n).
        thresholds: δ, above 0, shape (n,) [m].
        settings: The network's input scale s.
    """

    def __init__(
        self,
        response: Vector,
        modes: Vector,
        thresholds: Vector,
        settings: NetworkSettings | None = None,
    ) -> None:
        law = ModalPolicy(
            response, ModalSettings(), modes, 0.5, thresholds, policy_id="two-scale-begin"
        )
        self._first = embed(law, settings, policy_id="two-scale-begin")
        self._modes = law.modes
        self._bend = law.thresholds / LINEAR_RANGE
        self._linear = -self._first.settings.input_scale / LINEAR_RANGE

    def last(self, near: Vector, far: Vector) -> NDArray[np.float32]:
        """Make the last matrix, shape (m, h), of the gains, each (m, n) [A/m]."""
        n = len(self._modes)
        matrix = np.zeros_like(self._first.weights[-1])
        matrix[:, :n] = self._linear * (far @ self._modes)
        matrix[:, n : 2 * n] = ((far - near) @ self._modes) * self._bend
        matrix.setflags(write=False)
        return matrix

    def policy(
        self, near: Vector, far: Vector, response: Vector, policy_id: str | None = None
    ) -> NetworkPolicy:
        """Make the network.

        Args:
            near: Gain near zero, shape (m, n) [A/m].
            far: Gain far from zero, shape (m, n) [A/m].
            response: R̂ that they were made for, shape (n, m) [m/A].
            policy_id: Its name; by default from its content.
        """
        weights = (*self._first.weights[:-1], self.last(near, far))
        return NetworkPolicy(weights, response, self._first.settings, policy_id)
