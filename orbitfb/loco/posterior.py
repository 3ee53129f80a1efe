"""What normal equations and healthy spreads say of every parameter.

With the normal equations H θ = b of the data and a prior variance Λ for every parameter the
posterior is normal with covariance C = (H + Λ⁻¹)⁻¹. Of one parameter alone, the others as they
are, the data say m ± √v with 1/v = 1/C_kk − 1/Λ_k and m = v μ_k / C_kk; a healthy device has
m of variance Λ_k + v, so z = |m| / √(Λ_k + v) tells how far it stands out.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, get_lapack_funcs

from orbitfb.core.errors import RingError
from orbitfb.core.signals import Vector
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

WIDE = 25.0
"""Prior variance of a parameter that is let free: deviations of five times the nominal [1]."""

_BEYOND = 9.0
"""Median deviations, 6 standard deviations, from which a device does not count in a spread [1]."""


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """A normal posterior.

    Args:
        mean: μ, shape (k,).
        covariance: C, shape (k, k).
        prior: Λ, shape (k,).
    """

    mean: Vector
    covariance: Matrix
    prior: Vector

    @property
    def sigma(self) -> Vector:
        """Standard deviation of every parameter, shape (k,)."""
        return np.sqrt(np.diag(self.covariance))

    def by_data(self) -> tuple[Vector, Vector]:
        """Value m and variance v of every parameter by the data alone, the others as they are."""
        own = np.diag(self.covariance)
        known = np.maximum(1.0 / own - 1.0 / self.prior, 1e-9 / self.prior)
        variance = 1.0 / known
        return variance * self.mean / own, variance

    def standing(self, group: Indices, spread: float, centred: bool) -> Vector:
        """How far parameters of a group stand out of its healthy spread, z, shape (g,).

        Args:
            group: The parameters.
            spread: Healthy spread of the group.
            centred: Whether they are seen from their median: a common part of them is gauge, and a
                few that are far off pull it along.
        """
        value, variance = (its[group] for its in self.by_data())
        middle = float(np.median(value)) if centred and len(value) else 0.0
        return np.abs(value - middle) / np.sqrt(spread**2 + variance)


def most_likely(matrix: Matrix, pull: Vector, prior: Vector) -> Vector:
    """Solve the normal equations with a prior for the mean alone, shape (k,).

    Args:
        matrix: H, shape (k, k).
        pull: b, shape (k,).
        prior: Λ, shape (k,).
    """
    scale = np.sqrt(prior)
    inner = scale[:, None] * matrix * scale
    inner[np.diag_indices_from(inner)] += 1.0
    return scale * cho_solve(cho_factor(inner, lower=True, overwrite_a=True), scale * pull)


def posterior(matrix: Matrix, pull: Vector, prior: Vector) -> Posterior:
    """Solve the normal equations with a prior.

    Args:
        matrix: H, shape (k, k).
        pull: b, shape (k,).
        prior: Λ, shape (k,).

    Raises:
        RingError: There is no solution.
    """
    scale = np.sqrt(prior)
    inner = scale[:, None] * matrix * scale
    inner[np.diag_indices_from(inner)] += 1.0
    factorise, invert = get_lapack_funcs(("potrf", "potri"), (inner,))
    factor, failed = factorise(inner, lower=1)
    if failed:
        raise RingError("the fit of the response has no solution; is it finite, and of this ring?")
    lower, _ = invert(factor, lower=1)  # above the diagonal it is as clean as the factor
    covariance = lower + lower.T
    covariance[np.diag_indices_from(covariance)] *= 0.5
    covariance *= scale[:, None]
    covariance *= scale
    return Posterior(covariance @ pull, covariance, prior)


def robust_spread(its: Posterior, group: Indices, least: float) -> float:
    """Estimate the healthy spread of a group that the data know well, from its median.

    Args:
        its: The posterior.
        group: The parameters.
        least: Smallest spread.
    """
    value, variance = (each[group] for each in its.by_data())
    return spread_of(value - np.median(value), variance, least)


def spread_of(apart: Vector, variance: Vector, least: float) -> float:
    """Estimate the healthy spread of devices, a few of them aside.

    Seen from their middle, the variance of m is τ² + v. It is estimated by the biweight
    midvariance (F. Mosteller, J. W. Tukey, Data Analysis and Regression, 1977): devices beyond
    `_BEYOND` median deviations do not count, nearer ones the less the farther they are. Of some
    fifty devices it is twice as precise as the median deviation alone, and tails that real gains
    have are in it.

    Args:
        apart: m less the middle, shape (g,).
        variance: v, shape (g,).
        least: Smallest spread.
    """
    deviation = float(np.median(np.abs(apart)))
    if not deviation > 0.0:
        return least
    u = np.minimum((apart / (_BEYOND * deviation)) ** 2, 1.0)
    inside = u < 1.0
    weight = float(np.sum((1 - u[inside]) * (1 - 5 * u[inside])))
    square = len(apart) * float(np.sum(apart**2 * (1 - u) ** 4)) / weight**2
    return max(least, float(np.sqrt(max(0.0, square - float(np.median(variance))))))


def evidence_spread(its: Posterior, group: Indices, least: float) -> float:
    """Take one step to the spread of most evidence, for a group that the data know in part.

    MacKay's fixed point: τ² = Σ μ² / Σ (1 − C_kk / Λ_k).

    Args:
        its: The posterior.
        group: The parameters that count.
        least: Smallest spread.
    """
    if not len(group):
        return least
    own = np.diag(its.covariance)[group]
    known = float(np.sum(1.0 - own / its.prior[group]))
    square = float(np.sum(its.mean[group] ** 2))
    return max(least, float(np.sqrt(square / max(known, 1e-3))))
