"""Estimate the floor of a record: how its orbit walks, and how its readings are noisy.

The walk's covariance Q may have any shape; an inverse-Wishart prior keeps it near what magnets that
move make of it. The reading noise is one variance per BPM, and where it is asked for a part that is
coherent from BPM to BPM and new at every tick (vibration faster than the record). Both follow by
expectation maximisation (A. Dempster, N. Laird, D. Rubin, J. R. Stat. Soc. B 39 (1977) 1) from the
second moments of the transformed steps in bands of λ.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.core.errors import EstimationError
from orbitfb.core.signals import Vector
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.transform import Matrix, StepTransform

PRIOR_COUNTS = 100.0
"""Steps that the prior shape of the walk is worth: it rules modes that a record of some hundred
rows cannot show, and gives way where thousands speak."""

LEAST_STEPS = 40
"""Steps below which walk and noise cannot be told apart: λ then has too few values."""

_LEAST_VARIANCE = 1e-6
"""Least variance of a BPM's noise, of the median BPM's: one that repeats its reading has none."""


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """Second moments Σ_f z_f z_fᵀ of transformed steps, by band, shape (B, n, n) [m²].

    Args:
        total: By band.
        count: Frequencies of every band, shape (B,).
        eigenvalue: Mean λ of every band, shape (B,).
    """

    total: Matrix
    count: Vector
    eigenvalue: Vector

    @classmethod
    def of(cls, spectrum: Matrix, transform: StepTransform) -> "Moments":
        """Sum them up."""
        parts = [spectrum[transform.members(band)] for band in range(len(transform.count))]
        count = transform.count.astype(float)
        mean = np.bincount(transform.band, transform.eigenvalue) / count
        return cls(np.stack([part.T @ part for part in parts]), count, mean)


def first_noise(steps: Matrix, shape: Matrix) -> StepNoise:
    """Tell noise and walk from neighbouring steps: E Δz_n Δz_{n+1} = −v².

    Args:
        steps: From row to row, shape (T, n) [m].
        shape: Prior shape of the walk's covariance, shape (n, n).

    Raises:
        EstimationError: Too few steps, or steps that are all zero.
    """
    if len(steps) < LEAST_STEPS:
        raise EstimationError(
            f"{len(steps)} steps from row to row are too few to tell noise from motion; "
            f"give at least {LEAST_STEPS}, better a thousand"
        )
    square = np.mean(steps**2, axis=0)
    typical = float(np.median(square))
    if not typical > 0.0:
        raise EstimationError(
            "most BPMs read the same at every row: no noise, no motion; "
            "give a record of a live orbit"
        )
    noise = -np.mean(steps[1:] * steps[:-1], axis=0)
    noise = np.clip(noise, 0.02 * square, 0.5 * np.maximum(square, 1e-3 * typical))
    walk = max(float(np.mean(square - 2.0 * noise)), 1e-4 * float(np.mean(noise)))
    return StepNoise(shape * (walk * len(shape) / float(np.trace(shape))), np.diag(noise))


def improve(
    noise: StepNoise,
    moments: Moments,
    shape: Matrix,
    iterations: int,
    counts: float = PRIOR_COUNTS,
) -> StepNoise:
    """Go some steps of expectation maximisation.

    Args:
        noise: To begin with.
        moments: Of what no model explains.
        shape: Prior mean of the walk's covariance, shape (n, n) [m²].
        iterations: How many.
        counts: What the prior is worth, in steps.
    """
    walk, white = noise.walk, np.diag(noise.white).copy()
    total = float(moments.count.sum())
    for _ in range(iterations):
        moved, shaken = np.zeros_like(walk), np.zeros_like(white)
        for square, count, eigenvalue in zip(
            moments.total, moments.count, moments.eigenvalue, strict=True
        ):
            inverse = np.linalg.inv(walk + eigenvalue * np.diag(white))
            beyond = square - count * (walk + eigenvalue * np.diag(white))
            whitened = inverse @ beyond @ inverse
            moved += count * walk + walk @ whitened @ walk
            shaken += count * white + eigenvalue * white**2 * np.diag(whitened)
        walk = (counts * shape + moved) / (counts + total)
        walk = (walk + walk.T) / 2.0
        white = shaken / total
        white = np.maximum(white, _LEAST_VARIANCE * float(np.median(white)))
    return StepNoise(walk, np.diag(white))


def fit_families(
    noise: StepNoise,
    moments: Moments,
    families: Sequence[Matrix],
    held: Matrix,
    rounds: int = 30,
) -> StepNoise:
    """Fit a walk that is a mixture of families, and one reading noise per BPM.

    The weights w of Q = Σ w_k F_k and the variances of the noise rise and fall by the ratio of what
    the data pull to what the covariance expects (T. W. Anderson, Ann. Stat. 1 (1973) 135); unlike
    expectation maximisation this is quick also where a component is small beside the noise.

    Args:
        noise: To begin with.
        moments: Of what no model explains.
        families: Positive covariances of any scale, each (n, n).
        held: Covariance of the walk that is known besides, shape (n, n) [m²].
        rounds: At most; it ends when no weight moves by more than a hundredth.
    """
    white = np.diag(noise.white).copy()
    weights = _start(white, moments, families)
    for _ in range(rounds):
        walk = sum_of(weights, families) + held
        pull, expected = np.zeros_like(walk), np.zeros_like(walk)
        shaken, usual = np.zeros_like(white), np.zeros_like(white)
        for square, count, eigenvalue in zip(
            moments.total, moments.count, moments.eigenvalue, strict=True
        ):
            inverse = np.linalg.inv(walk + eigenvalue * np.diag(white))
            seen = inverse @ square @ inverse
            pull += seen
            expected += count * inverse
            shaken += eigenvalue * np.diag(seen)
            usual += count * eigenvalue * np.diag(inverse)
        ratio = np.array([np.sum(pull * one) / np.sum(expected * one) for one in families])
        ratio = np.maximum(ratio, 1e-3)
        weights = weights * ratio
        white = np.maximum(white * shaken / usual, _LEAST_VARIANCE * float(np.median(white)))
        share = weights / weights.sum()
        if np.all(np.abs(ratio - 1.0)[share > 0.01] < 0.01):
            break
    return StepNoise(sum_of(weights, families) + held, np.diag(white))


def _start(white: Vector, moments: Moments, families: Sequence[Matrix]) -> Vector:
    """Weights of families, each a share of the level at which all together are most likely."""
    mixed = sum_of(np.ones(len(families)) / len(families), families)
    unit = StepNoise(
        mixed * (float(np.mean(white)) / float(np.mean(np.diag(mixed)))), np.diag(white)
    )
    square = np.einsum("nm,bnk,km->bm", unit.modes, moments.total, unit.modes, optimize=True)
    levels = np.geomspace(1e-6, 1e3, 60)
    count, eigenvalue = moments.count[:, None], moments.eigenvalue[:, None]
    worth = [
        float(np.sum(-0.5 * count * np.log(v) - 0.5 * square / v))
        for v in (level * unit.ratio + eigenvalue for level in levels)
    ]
    level = levels[int(np.argmax(worth))]
    scale = level * float(np.mean(white)) / float(np.mean(np.diag(mixed)))
    return np.full(len(families), scale / len(families))


def sum_of(weights: Vector, families: Sequence[Matrix]) -> Matrix:
    """Sum families by their weights."""
    total = np.zeros_like(families[0])
    for weight, family in zip(weights, families, strict=True):
        total += weight * family
    return total
