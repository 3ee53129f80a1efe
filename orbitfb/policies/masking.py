"""How a policy works on when BPMs are masked.

A law that is linear in the response drops the rows of the masked BPMs and is solved again. A
law that is not, or that needs whole modes, fills the gaps in: given the valid readings e_v, the
missing ones are expected to be

    E[e_w | e_v] = C_wv C_vv⁻¹ e_v,   C = c (R Rᵀ / t + f I),   t = tr(R Rᵀ) / n,

the conditional mean of a normal orbit with covariance C. R Rᵀ is the covariance of orbits that
independent kicks at the correctors make; kicks of the quadrupoles give nearly the same. The
floor f stands for what no corrector makes, reading noise above all, and keeps the inverse well
conditioned.

Source: the conditional normal distribution, e.g. Rasmussen and Williams, Gaussian Processes for
Machine Learning, appendix A.2.
"""

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.policies.recent import Recent

FLOOR = 1e-4
"""Part of the orbit's variance that no corrector explains [1]."""


class Infill:
    """Fills in the readings of masked BPMs; may be shared between threads.

    Args:
        response: R, shape (n, m) [m/A].
        floor: Variance that no corrector explains, relative to the mean of R Rᵀ [1].
    """

    def __init__(self, response: Vector, floor: float = FLOOR) -> None:
        self._response, self._floor = response, floor
        self._matrices: Recent[Vector] = Recent(self._matrix)

    def fill(self, error: Vector, valid: Mask) -> Vector:
        """Replace what is not valid by what is expected there.

        A mask that is new costs one solution of equations (about 2 ms for 180 BPMs).

        Args:
            error: Orbit − reference, shape (n,) [m]; elements that are not valid are ignored.
            valid: BPMs that count, shape (n,).

        Returns:
            Shape (n,) [m], finite; zeros when nothing is valid.
        """
        known = error[valid]
        filled = np.empty(len(error))
        filled[valid] = known
        filled[~valid] = self._matrices.get(valid) @ known
        return filled

    def _matrix(self, valid: Mask) -> Vector:
        """Give C_wv C_vv⁻¹, shape (masked, valid)."""
        known = self._response[valid]
        scale = float(np.mean(np.sum(self._response**2, axis=1)))
        among = known @ known.T + self._floor * scale * np.eye(len(known))
        across = known @ self._response[~valid].T
        return np.asarray(np.linalg.solve(among, across).T, dtype=np.float64)
