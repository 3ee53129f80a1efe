"""Estimate the floor of a record: how its orbit walks, and how its readings are noisy.

The walk's covariance Q may have any shape; an inverse-Wishart prior keeps it near what magnets that
move make of it. The reading noise is one variance per BPM, and where it is asked for a part that is
coherent from BPM to BPM and new at every tick (vibration faster than the record). Both follow by
expectation maximisation (A. Dempster, N. Laird, D. Rubin, J. R. Stat. Soc. B 39 (1977) 1) from the
second moments of the transformed steps in bands of λ.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.linalg import eigh

from orbitfb.core.errors import EstimationError
from orbitfb.core.signals import Vector
from orbitfb.estimation.moments import Moments, at_least, weighed_sums
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.priors import FREELY, LEAST_STEPS
from orbitfb.estimation.shapes import Shapes, fit_shapes
from orbitfb.estimation.transform import Matrix

_GLANCE = 2
"""Steps up the likelihood by which priors are compared. By hand: only their order counts."""

_RANK_SHARE = 1e-9
"""Share of the mean variance of the walk that any orbit has in comparisons of floors [1]: far above
rounding, far below what a record shows."""


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
    counts: float,
) -> StepNoise:
    """Go some steps up the likelihood, by minorisation.

    H. Zhou et al., J. Comput. Graph. Stat. 28 (2019) 350, for matrices: unlike expectation
    maximisation it is quick also where the walk is small beside the noise.

    Args:
        noise: To begin with.
        moments: Of what no model explains.
        shape: Prior mean of the walk's covariance, shape (n, n) [m²].
        iterations: How many.
        counts: What the prior is worth, in steps; infinite: the walk stays as it is.
    """
    for _ in range(iterations if np.isfinite(counts) else 0):
        pull, expected, noisy, usual = weighed_sums(noise, moments)
        walk = _nearer(noise.walk, pull, expected, shape, counts)
        reading = noise.reading * np.sqrt(np.diag(noisy) / np.diag(usual))
        reading = at_least(reading)
        noise = noise.improved(walk, reading)
    return noise


def trusted(noise: StepNoise, halves: tuple[Moments, Moments], choices: Sequence[float]) -> float:
    """What the prior shape of the walk is worth, in steps: by what one half says of the other.

    Where the shapes are those of the ring's ground, a walk that leaves them follows chance and fits
    the other half of the frequencies worse; where they are not, better.

    Args:
        noise: That the shapes make; its walk is the prior's.
        halves: Moments of every other frequency, and of the rest.
        choices: Counts to choose from.
    """

    def told(half: Moments) -> list[StepNoise]:
        return [improve(noise, half, noise.walk, _GLANCE, counts) for counts in choices]

    return choices[int(np.argmax(_by_the_other(halves, told)))]


def foretold(
    noise: StepNoise,
    halves: tuple[Moments, Moments],
    shapes: Shapes,
    held: Matrix,
    weights: Vector,
    choices: Sequence[float],
) -> list[float]:
    """Log density of each half of the frequencies under the floor that the other one tells.

    What a floor follows by chance in one half is not in the other, so that floors which are free in
    unlike ways may be compared.

    Args:
        noise: To begin with.
        halves: Moments of every other frequency, and of the rest.
        shapes: That the walk may have.
        held: Covariance of the walk that is known besides, shape (n, n) [m²].
        weights: Of the shapes, to begin with, shape (F,).
        choices: What the shapes may be worth as a prior, in steps; of each it is told.
    """

    def told(half: Moments) -> list[StepNoise]:
        mixed, _ = fit_shapes(noise, half, shapes, held, weights)
        return [improve(mixed, half, mixed.walk, FREELY, counts) for counts in choices]

    return _by_the_other(halves, told)


def _by_the_other(
    halves: tuple[Moments, Moments], told: Callable[[Moments], list[StepNoise]]
) -> list[float]:
    """Log density of the halves, each under the floor that the other tells, of every such floor."""
    first, second = (
        [other.log_density(floor) for floor in told(one)] for one, other in (halves, halves[::-1])
    )
    return [sum(both) for both in zip(first, second, strict=True)]


def distance(walk: Matrix, prior: Matrix) -> float:
    """Twice what an inverse-Wishart prior worth one step takes off a walk that is not its mean.

    Args:
        walk: Its covariance, shape (n, n) [m²].
        prior: Mean of the prior, shape (n, n) [m²].
    """
    # Where the prior says of an orbit that it never walks, rounding is what is compared.
    least = _RANK_SHARE * float(np.trace(prior)) / len(prior) * np.eye(len(prior))
    ratio = np.maximum(eigh(walk + least, prior + least, eigvals_only=True), 1e-300)
    return float(np.sum(np.log(ratio) + 1.0 / ratio - 1.0))


def _nearer(walk: Matrix, pull: Matrix, expected: Matrix, shape: Matrix, counts: float) -> Matrix:
    """Solve Q E Q + c Q = Q₀ P Q₀ + c S: the maximum of what bounds the log likelihood from below.

    Args:
        walk: Q₀.
        pull: P, what the data pull.
        expected: E, what the covariance expects.
        shape: S, prior mean.
        counts: c, what the prior is worth.
    """
    root = np.linalg.cholesky(expected)
    wanted = root.T @ (walk @ pull @ walk + counts * shape) @ root
    size, modes = np.linalg.eigh((wanted + wanted.T) / 2.0)
    solved = np.sqrt(np.maximum(size, 0.0) + counts**2 / 4.0) - counts / 2.0
    along = np.linalg.solve(root.T, modes)
    return (along * solved) @ along.T
