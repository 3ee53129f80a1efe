"""The coefficients θ of all modes and what is not known of them, learnt in blocks of ticks.

Within a block the orbit is filtered as if R were what it was when the block began. That is the
Kalman filter of an orbit under known changes, with the shares s = r²/S_known of every group and
every tick; what it leaves of the readings is

    z_t = φ_tᵀ δθ + d_t δx + v_t,     var(v_t) = S_known,t,     φ ← s φ + u,   d ← s d,

δθ what R was mistaken in, δx what the orbit was mistaken in for want of R when the block began.
With v_t white, that is a linear regression: δθ and δx have the covariances P, c = cov(θ, x) and
e = var(δx), and the answer to all readings of a block is that of the filter which learns from one
after the other. It costs products of matrices, of which a tick's share is small, in place of
products of P and a vector at every tick.

Modes of a group may differ in their noise: each learns from its own innovations, over variances
of its own, while P shrinks by what those of the whole group are worth.

Source: for the innovations Ljung and Söderström, Theory and Practice of Recursive Identification
(1983), ch. 3; with the Cholesky factor of their covariance as whitening filter, e.g. Kailath,
Sayed and Hassibi, Linear Estimation, ch. 4.
"""

from collections.abc import Sequence

import numpy as np

from orbitfb.core.errors import EstimationError
from orbitfb.core.signals import Vector
from orbitfb.estimation.recursive.block import Block
from orbitfb.estimation.recursive.group import Group


class Coefficients:
    """θ̂ of n modes, and P = cov(θ), c = cov(θ, x) and e of every group of them.

    Args:
        groups: What is known beforehand.
        drift: What a tick adds to P of every group, shape (k, k).
        length: Most changes of a block.

    Attributes:
        rows: θ̂ of every mode, shape (n, k); nobody else writes into it.
        extra: e, what not knowing R adds to the variance of the orbit, shape (groups,) [m²].
        doubt: What it added to that of the last reading, over what that is without, (groups,) [1].
    """

    def __init__(self, groups: Sequence[Group], drift: Vector, length: int) -> None:
        self._members = [group.members for group in groups]
        self._drift, self._diagonal = drift, np.array([group.drift for group in groups])
        self.rows = np.concatenate([group.rows for group in groups])
        self._covariances = np.array([group.covariance for group in groups])
        self._cross = np.zeros((len(groups), len(drift)))
        self.extra, self.doubt = np.zeros((2, len(groups)))
        self._joint = np.empty((length + 1, len(drift)))
        self._product = np.empty_like(drift)
        from scipy.linalg import get_lapack_funcs  # half a second of a loop that never learns

        routines = get_lapack_funcs(("potrf", "trtri"), dtype=np.float64)
        self._factorise, self._invert = routines

    def learn(self, block: Block) -> Vector:
        """Learn from a block; it is left as it is.

        Args:
            block: What was changed and what was read since the last one.

        Returns:
            What the orbit of every mode was mistaken in at the end of the block, shape (n,) [m].

        Raises:
            EstimationError: What is known is not finite.
        """
        count, changes = len(self._members), block.changes
        weights, variances, innovations = block.weights(count), block.variances, block.innovations
        mistaken = np.zeros(len(self.rows))
        for group, members in enumerate(self._members):
            # covariances of (δx, changes · δθ) with θ and with themselves
            joint = self._joint[: len(changes) + 1]
            joint[0] = self._cross[group]
            np.dot(changes, self._covariances[group], out=joint[1:])
            inner = np.empty((len(joint), len(joint)))
            inner[:, 1:] = joint @ changes.T
            inner[0, 0], inner[1:, 0] = self.extra[group], inner[0, 1:]
            seen, end = weights[group, :-1], weights[group, -1]
            carried = inner @ end
            self._cross[group], self.extra[group] = end @ joint, end @ carried
            if not block.readings:
                continue
            known = variances[:, group - count]
            covariance = seen @ inner @ seen.T
            covariance.flat[:: len(seen) + 1] += known
            factor, failed = self._factorise(covariance, lower=1)
            if failed:
                raise EstimationError(
                    "what is expected of the readings is not a finite covariance; begin with "
                    "another response, or check its noise and its prior"
                )
            whitening = self._invert(factor, lower=1)[0]
            white = whitening @ seen
            told, along = white @ joint, white @ carried
            total = np.diagonal(factor) ** 2
            worth = whitening @ innovations[:, members]
            own = variances[:, members] - known[:, None]
            worth *= total[:, None] / (total[:, None] + own)
            self.rows[members] += worth.T @ told
            mistaken[members] = along @ worth
            np.dot(told.T, told, out=self._product)
            self._covariances[group] -= self._product
            self._cross[group] -= along @ told
            self.extra[group] = max(self.extra[group] - float(along @ along), 0.0)
            self.doubt[group] = total[-1] / known[-1] - 1.0
        return mistaken

    def forget_orbit(self) -> None:
        """Let what is not known of R have no part in what is not known of the orbit."""
        self._cross[:] = 0.0
        self.extra = np.zeros(len(self.extra))

    def add_drift(self, ticks: int) -> None:
        """Add what the random walk of R does in some ticks."""
        np.multiply(self._drift, ticks, out=self._product)
        self._covariances += self._product
        size = len(self._drift)
        self._covariances.reshape(-1, size**2)[:, :: size + 1] += ticks * self._diagonal

    def traces(self) -> Vector:
        """Give the trace of P of every group, shape (groups,)."""
        return np.trace(self._covariances, axis1=1, axis2=2)

    def widen(self, factors: Vector) -> None:
        """Multiply P of every group by its factor, shape (groups,)."""
        self._covariances *= factors[:, None, None]

    def covariances(self, size: int) -> tuple[Vector, ...]:
        """Give the covariance of the first coefficients in every group, each (size, size)."""
        return tuple(0.5 * (part + part.T) for part in self._covariances[:, :size, :size])
