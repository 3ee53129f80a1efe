"""Noise of every row and column of a measured response, from what a fit leaves over."""

import numpy as np

from orbitfb.core.robust import TO_SIGMA
from orbitfb.core.signals import Mask, Vector
from orbitfb.physics.optics import Matrix

_ROUNDS = 4


def spreads(residual: Matrix, kept: Mask) -> tuple[Vector, Vector]:
    """Estimate σ_ij = s_i t_j robustly; the median t is 1.

    Args:
        residual: Shape (n, m) [m/rad].
        kept: Elements that count, shape (n, m).

    Returns:
        s, shape (n,) [m/rad], and t, shape (m,) [1]; NaN where nothing counts.
    """
    size = np.where(kept, np.abs(residual), np.nan)
    rows, columns = kept.any(axis=1), kept.any(axis=0)
    s, t = np.full(len(size), np.nan), np.full(size.shape[1], np.nan)
    t[columns] = 1.0
    inner = size[np.ix_(rows, columns)]
    if not inner.size:
        return s, t
    mine, its = np.ones(inner.shape[0]), np.ones(inner.shape[1])
    for _ in range(_ROUNDS):
        mine = TO_SIGMA * np.nanmedian(inner / its, axis=1)
        mine = np.maximum(mine, 1e-6 * (np.median(mine) or 1.0))
        its = TO_SIGMA * np.nanmedian(inner / mine[:, None], axis=0)
        its = np.maximum(its, 1e-6)
        its /= np.median(its)
    s[rows], t[columns] = mine, its
    return s, t


def of_repeats(values: Vector) -> tuple[Matrix, Matrix]:
    """Take the mean of repeated measurements, and its noise from their scatter.

    The variance of an element from a few repeats is worth little: those of its row and of its
    column are pooled, σ_ij = s_i t_j.

    Args:
        values: Shape (repeats, n, m); NaN where not measured.

    Returns:
        Mean and standard deviation of the mean, both (n, m); NaN where nothing is known.
    """
    count = np.isfinite(values).sum(axis=0)
    total = np.where(np.isfinite(values), values, 0.0).sum(axis=0)
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    apart = np.where(np.isfinite(values), values - mean, 0.0)
    squares, freedom = (apart**2).sum(axis=0), np.maximum(count - 1, 0)

    def pooled(weight: Matrix, axis: int) -> Vector:
        known = freedom.sum(axis=axis)
        its = (squares / weight).sum(axis=axis) / np.maximum(known, 1)
        return np.where((known > 0) & (its > 0), its, np.nan)

    rows = pooled(np.ones_like(mean), 1)
    columns = pooled(np.where(np.isfinite(rows), rows, 1.0)[:, None] * np.ones_like(mean), 0)
    return mean, np.sqrt(np.outer(rows, columns) / np.maximum(count, 1))


def separable(sigma: Matrix) -> tuple[Vector, Vector]:
    """Write known noise as s_i t_j, the nearest in the logarithm; NaN where nothing is known.

    Args:
        sigma: Shape (n, m) [m/rad].
    """
    logs = np.log(np.where(np.isfinite(sigma) & (sigma > 0), sigma, np.nan))
    rows, columns = np.isfinite(logs).any(axis=1), np.isfinite(logs).any(axis=0)
    s, t = np.full(len(logs), np.nan), np.full(logs.shape[1], np.nan)
    inner = logs[np.ix_(rows, columns)]
    if not inner.size:
        return s, t
    mine = np.nanmean(inner, axis=1)
    its = np.nanmean(inner - mine[:, None], axis=0)
    middle = float(np.median(its))
    s[rows], t[columns] = np.exp(mine + middle), np.exp(its - middle)
    return s, t
