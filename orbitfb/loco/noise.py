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
