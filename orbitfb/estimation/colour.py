"""How the walk of the ground differs from a walk from one octave of frequency to the next.

A walk has steps of one variance at every frequency. Ground that springs back has less of them at
slow ones, ground that goes on in the direction of before has less at fast ones, one that drifts as
temperature does has more at slow ones. The logarithm of the variance is free at every octave, but
rises with frequency in none of the fastest, where noise of the readings does. Its changes from one
octave to the next have a normal prior.
"""

from functools import cache

import numpy as np
from scipy.linalg import solve

from orbitfb.core.signals import Vector
from orbitfb.estimation.priors import MOST_PER_OCTAVE, OCTAVES, OCTAVES_OF_NOISE, PER_OCTAVE
from orbitfb.estimation.transform import Matrix

_STEP = 1.0
"""Most that a logarithm changes in one step of the fit [1]. By hand: Newton's method is right near
its end, and far from it the direction is."""

_CLIMBS = 6
"""Steps of a fit at most. By hand: Newton's method, begun at the fit before."""

_LEAST_KNOWN = 1e-6
"""Information on the level of a walk of which nothing shows, so that it stays. By hand: far less
than one frequency has."""

_SETTLED = 1e-3
"""Change of the logarithm at which a fit ends, far below what a record shows."""


def ramps(eigenvalue: Vector) -> Matrix:
    """What a change between two octaves does to ln(variance) at some λ = 2 − 2 cos ω, (F, K).

    Octave k lies between ω = π 2^(1−k) and π 2^−k. All are zero on average over all ω.
    """
    return _ramps(eigenvalue) - _average()


def _ramps(eigenvalue: Vector) -> Matrix:
    angle = np.arccos(np.clip(1.0 - eigenvalue / 2.0, -1.0, 1.0))
    octave = -np.log2(np.maximum(angle, 1e-9) / np.pi)
    octaves = np.arange(OCTAVES, dtype=float)
    return np.clip(octave[:, None] - octaves, 0.0, 1.0)


@cache
def _average() -> Vector:
    """Over all frequencies, those near zero as fine as those near the fastest, shape (K,)."""
    edges = np.pi * np.concatenate([[0.0], np.geomspace(2.0**-OCTAVES / 8.0, 1.0, 40 * OCTAVES)])
    middle = (edges[1:] + edges[:-1]) / 2.0
    return np.asarray(np.diff(edges) @ _ramps(2.0 - 2.0 * np.cos(middle)) / np.pi)


def rarity(changes: Matrix) -> float:
    """What changes from octave to octave, shape (P, K), take off the log prior [nats]."""
    return 0.5 * float(np.sum(changes**2)) / PER_OCTAVE**2


def choice(ratio: Vector, eigenvalue: Vector, changes: Vector) -> float:
    """What is lost by having fitted the changes, in Laplace's approximation [nats].

    Args:
        ratio: Variance of the walk of every mode, in that of its noise, shape (n,).
        eigenvalue: λ of every frequency, shape (T,).
        changes: From octave to octave, shape (K,).
    """
    along = ramps(eigenvalue)
    walk = np.outer(np.exp(along @ changes), ratio)
    weight = 0.5 * np.sum((walk / (walk + eigenvalue[:, None])) ** 2, axis=1)
    known = PER_OCTAVE**2 * (along.T * weight) @ along
    return 0.5 * float(np.linalg.slogdet(np.eye(len(changes)) + known)[1])


def changed(
    ratio: Vector, square: Matrix, eigenvalue: Vector, changes: Vector
) -> tuple[float, Vector]:
    """Fit level and changes of a walk to the squares of modes, by Fisher's scoring.

    Args:
        ratio: Variance of the walk of every mode, in that of its noise, shape (n,).
        square: Of the modes, shape (T, n).
        eigenvalue: λ of every frequency, shape (T,).
        changes: From octave to octave to begin with, shape (K,).

    Returns:
        Factor of the walk [1], and the changes of ln(variance), shape (K,).
    """
    along = np.column_stack([np.ones(len(eigenvalue)), ramps(eigenvalue)])
    sizes = np.concatenate([[0.0], changes])
    known = np.concatenate([[0.0], np.full(len(changes), PER_OCTAVE**-2)])
    most = np.concatenate([[np.inf], np.full(len(changes), MOST_PER_OCTAVE)])
    least = np.where(np.arange(len(sizes)) - 1 < OCTAVES_OF_NOISE, 0.0, -most)
    least[0] = -np.inf

    def likely(sizes: Vector) -> float:
        total = np.outer(np.exp(along @ sizes), ratio) + eigenvalue[:, None]
        return -0.5 * float(np.sum(np.log(total) + square / total) + known @ sizes**2)

    best = likely(sizes)
    for _ in range(_CLIMBS):
        walk = np.outer(np.exp(along @ sizes), ratio)
        total = walk + eigenvalue[:, None]
        share = walk / total
        pull = 0.5 * np.sum(share * (square / total - 1.0), axis=1)
        weight = 0.5 * np.sum(share**2, axis=1)
        curved = (along.T * weight) @ along + np.diag(known)
        curved[0, 0] += _LEAST_KNOWN
        slope = along.T @ pull - known * sizes
        free = np.where(slope > 0.0, sizes < most, sizes > least)
        step = np.zeros_like(sizes)
        step[free] = solve(curved[np.ix_(free, free)], slope[free], assume_a="pos")
        step = np.clip(step, -_STEP, _STEP)
        while True:
            tried = np.clip(sizes + step, least, most)
            more = likely(tried) - best
            if more > 0.0 or np.max(np.abs(tried - sizes)) <= _SETTLED:
                break
            step = step / 2.0
        if not more > _SETTLED:
            break
        sizes, best = tried, best + more
    return float(np.exp(sizes[0])), sizes[1:]
