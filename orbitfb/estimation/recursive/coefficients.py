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

In single precision P and the covariance of the readings are positive only within what rounding
makes of k terms, ε √k of what stands on their diagonals: so much is added there.

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
from orbitfb.estimation.recursive.block import Block, Precise
from orbitfb.estimation.recursive.group import Group


class Coefficients:
    """θ̂ of n modes, and P = cov(θ), c = cov(θ, x) and e of every group of them.

    Args:
        groups: What is known beforehand.
        drift: What a tick adds to P of every group, shape (k, k).
        length: Most changes of a block.
        precision: Of θ̂, P, c and the products with them, as a dtype.

    Attributes:
        rows: θ̂ of every mode, shape (n, k); nobody else writes into it.
        extra: e, what not knowing R adds to the variance of the orbit, shape (groups,) [m²].
        doubt: What it added to that of the last reading, over what that is without, (groups,) [1].
    """

    def __init__(
        self, groups: Sequence[Group], drift: Vector, length: int, precision: type[np.floating]
    ) -> None:
        self._members = [group.members for group in groups]
        self._group_of = np.repeat(np.arange(len(groups)), [group.size for group in groups])
        self._precision, self._drift = precision, drift.astype(precision)
        self._diagonal = np.array([group.drift for group in groups], dtype=precision)
        self.rows = np.concatenate([group.rows for group in groups]).astype(precision)
        self._covariances = np.array([group.covariance for group in groups], dtype=precision)
        self._diagonals = self._covariances.reshape(len(groups), -1)[:, :: len(drift) + 1]
        self._last = self._diagonals[:, -1].copy()
        self._rounding = precision(np.finfo(precision).eps * np.sqrt(len(drift)))
        self._cross = np.zeros((len(groups), len(drift)), dtype=precision)
        self.extra, self.doubt = np.zeros((2, len(groups)))
        self._product = np.empty_like(self._drift)
        self._joint = np.empty((len(groups), 1 + length, len(drift)), dtype=precision)
        # half a second of a loop that never learns
        from scipy.linalg import get_blas_funcs, get_lapack_funcs

        (self._add_product,) = get_blas_funcs(("gemm",), dtype=precision)
        (self._invert,) = get_lapack_funcs(("trtri",), dtype=np.float64)

    def learn(self, block: Block) -> Vector:
        """Learn from a block; it is left as it is.

        Args:
            block: What was changed and what was read since the last one.

        Returns:
            What the orbit of every mode was mistaken in at the end of the block, shape (n,) [m].

        Raises:
            EstimationError: What is known is not finite.
        """
        changes, weights = block.changes, block.weights()
        seen, end = weights[:, :-1], weights[:, -1]
        joint, inner = self._covariances_with(changes)
        carried = _times(inner, end)
        self._cross = _times(joint.transpose(0, 2, 1), end.astype(self._precision))
        self.extra = np.einsum("gj,gj->g", end, carried)
        if not block.readings:
            return np.zeros(len(self.rows))
        count, of = len(self._members), self._group_of
        variances, known = block.variances[:, : len(of)], block.variances[:, len(of) :]
        covariance = seen @ inner @ seen.transpose(0, 2, 1)
        diagonal = covariance.reshape(count, -1)[:, :: block.readings + 1]
        diagonal += known.T + self._rounding * np.sum(diagonal, axis=1, keepdims=True)
        try:
            factors = np.linalg.cholesky(covariance)
        except np.linalg.LinAlgError as error:
            raise EstimationError(
                "what is expected of the readings is not a finite covariance; begin with "
                "another response, or check its noise and its prior"
            ) from error
        whitening = np.array([self._invert(factor, lower=1)[0] for factor in factors])
        white = whitening @ seen
        told, along = white.astype(self._precision) @ joint, _times(white, carried)
        total = np.diagonal(factors, axis1=1, axis2=2) ** 2
        worth = np.empty_like(variances)
        for group, members in enumerate(self._members):
            worth[:, members] = whitening[group] @ block.innovations[:, members]
        ends = total.T[:, of]
        worth *= ends / (ends + variances - known[:, of])
        precise = worth.astype(self._precision)
        for group, members in enumerate(self._members):
            self.rows[members] += precise[:, members].T @ told[group]
            its, columns = self._covariances[group].T, told[group].T
            self._add_product(-1.0, columns, columns, 1.0, its, trans_b=1, overwrite_c=1)
        self._diagonals *= 1.0 + self._rounding
        self._cross -= _times(told.transpose(0, 2, 1), along.astype(self._precision))
        self.extra = np.maximum(self.extra - np.einsum("gj,gj->g", along, along), 0.0)
        self.doubt = total[:, -1] / known[-1] - 1.0
        return np.sum(along.T[:, of] * worth, axis=0)

    def _covariances_with(self, changes: Precise) -> tuple[Precise, Vector]:
        """Give the covariances of (δx, changes · δθ) with θ and with themselves, of every group.

        Args:
            changes: Shape (j, k).

        Returns:
            Shapes (groups, 1 + j, k) and (groups, 1 + j, 1 + j).
        """
        count, (j, k) = len(self._members), changes.shape
        joint = self._joint[:, : 1 + j]
        joint[:, 0] = self._cross
        np.matmul(changes, self._covariances, out=joint[:, 1:])
        inner = np.empty((count, 1 + j, 1 + j))
        inner[:, :, 1:] = (np.reshape(joint, (-1, k)) @ changes.T).reshape(count, 1 + j, j)
        inner[:, 0, 0], inner[:, 1:, 0] = self.extra, inner[:, 0, 1:]
        return joint, inner

    def forget_orbit(self) -> None:
        """Let what is not known of R have no part in what is not known of the orbit."""
        self._cross[:] = 0.0
        self.extra = np.zeros(len(self.extra))

    def add_drift(self, ticks: int) -> None:
        """Add what the random walk of R does in some ticks."""
        np.multiply(self._drift, ticks, out=self._product)
        self._covariances += self._product
        self._diagonals += ticks * self._diagonal

    def turn(self, kept: float) -> None:
        """Know of the last coefficient only a share, from −1 to 1; the rest is what it may be."""
        self.rows[:, -1] *= kept
        self._cross[:, -1] *= kept
        self._covariances[:, -1, :] *= kept
        self._covariances[:, :, -1] *= kept
        self._diagonals[:, -1] += (1.0 - kept**2) * self._last

    def traces(self) -> Vector:
        """Give the trace of P of every group, shape (groups,)."""
        return np.trace(self._covariances, axis1=1, axis2=2, dtype=np.float64)

    def widen(self, factors: Vector) -> None:
        """Multiply P of every group by its factor, shape (groups,)."""
        self._covariances *= factors[:, None, None].astype(self._precision)

    def covariances(self, size: int) -> tuple[Vector, ...]:
        """Give the covariance of the first coefficients in every group, each (size, size)."""
        return tuple(_symmetric(part[:size, :size]) for part in self._covariances)

    def covariance(self, size: int, shares: Vector) -> Vector:
        """Give the sum of these with shares of the groups, shape (groups,), as (size, size)."""
        precise = shares.astype(self._precision)
        return _symmetric(np.tensordot(precise, self._covariances, axes=1)[:size, :size])


def _times(matrices: Precise, vectors: Precise) -> Precise:
    """Give every matrix, (j, n, m), times its vector, (j, m): shape (j, n)."""
    return np.matmul(matrices, vectors[:, :, None])[:, :, 0]


def _symmetric(matrix: Precise) -> Vector:
    """Give what rounding has left of a symmetric matrix, in double precision."""
    whole = matrix.astype(np.float64)
    return 0.5 * (whole + whole.T)
