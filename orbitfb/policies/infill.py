"""Masked BPMs: gaps are filled in, and nothing moves unseen.

Given the readings e_v of the valid BPMs, those of the masked ones are expected to be

    E[e_w | e_v] = C_wv C_vv⁻¹ e_v,   C = c (R Rᵀ + f diag(R Rᵀ)),

the conditional mean of a normal orbit with covariance C. R Rᵀ is the covariance of orbits that
independent kicks at the correctors make; kicks of the quadrupoles give nearly the same. The
floor f stands for what no corrector makes, reading noise above all, and keeps the inverse well
conditioned. It is a share of each BPM's own variance, so that planes do not mix.

A change that answers such an orbit has a part of which the valid BPMs see nothing: it moves the
orbit at the masked ones alone. Nothing corrects that part, and tick by tick the noise adds to it.
So the change that is made is the least one which moves the valid BPMs alike:

    a ← R_v⁺ R_v a = (I − N Nᵀ) a,     R_v N = 0,  Nᵀ N = I.

The setpoints then stay where those of a law stay that is solved for the valid BPMs alone.

Source: the conditional normal distribution, e.g. Rasmussen and Williams, Gaussian Processes for
Machine Learning, appendix A.2; for the null space Golub and Van Loan, Matrix Computations, ch. 5.
"""

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.policies.recent import Recent

FLOOR = 1e-4
"""Part of the orbit's variance that no corrector explains [1]."""
NOISY = 1e-2
"""The same for a law without memory, which answers the noise of the readings as it is. By hand, of
the decades from 1e-6 to 0.1; what it leaves stands in the column `masked` of
`benchmarks.policies`."""


class Infill:
    """Does for a law what masked BPMs call for; may be shared between threads.

    Args:
        response: R, shape (n, m) [m/A].
        floor: Variance that no corrector explains, over that which correctors make, f [1].
    """

    def __init__(self, response: Vector, floor: float = FLOOR) -> None:
        self._response, self._floor = response, floor
        self._matrices: Recent[Vector] = Recent(self._matrix)
        self._unseen: Recent[Vector] = Recent(self._null_space)

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

    def least(self, change: Vector, valid: Mask) -> Vector:
        """Give the least change that moves the valid BPMs as this one does.

        A mask that is new costs one factorisation (about 5 ms for 180 BPMs).

        Args:
            change: Of the setpoints, shape (m,) [A].
            valid: BPMs that count, shape (n,).

        Returns:
            Shape (m,) [A]; zeros when nothing is valid.
        """
        unseen = self._unseen.get(valid)
        return change - unseen @ (change @ unseen)

    def _matrix(self, valid: Mask) -> Vector:
        """Give C_wv C_vv⁻¹, shape (masked, valid)."""
        known = self._response[valid]
        among = known @ known.T
        own = np.diag(among)
        among += np.diag(np.where(own > 0.0, self._floor * own, 1.0))  # one that nothing moves: any
        across = known @ self._response[~valid].T
        return np.asarray(np.linalg.solve(among, across).T, dtype=np.float64)

    def _null_space(self, valid: Mask) -> Vector:
        """Give N, shape (m, m − valid), (m, 0) where no fewer BPMs than correctors are valid."""
        known = self._response[valid]
        return np.linalg.qr(known.T, mode="complete")[0][:, len(known) :].copy()
