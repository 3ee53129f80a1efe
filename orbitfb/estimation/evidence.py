"""Evidence of terms that add to the steps: closed forms.

A term h adds size · s_h to the transformed steps, s_h = pattern ⊗ course. With
its pull a_h = Σ_f s_hᵀ Ω_f z_f and its information H_hk = Σ_f s_hᵀ Ω_f s_k the log likelihood ratio
to having no term is

    given size θ:              a θ − ½ H θ²
    size normal, variance v:   ½ a² v / (1 + H v) − ½ ln(1 + H v)
    many at once, variances Λ: ½ bᵀ(Λ⁻¹ + G)⁻¹ b − ½ ln |1 + Λ G|
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, get_lapack_funcs, solve_triangular
from scipy.sparse.linalg import aslinearoperator, cg

from orbitfb.core.signals import Vector
from orbitfb.estimation.transform import Indices, Matrix

(_POTRI,) = get_lapack_funcs(("potri",), dtype=np.float64)

ROUNDING = 1e-12
"""Share of the information of a term that may be rounding [1]: sums of thousands of numbers are
right to that, and terms that are nearly alike must not seem to be apart."""


def given_size(pull: Vector, information: Vector, size: Vector | float = 1.0) -> Vector:
    """Log likelihood ratio of terms of a given size."""
    return pull * size - 0.5 * information * size**2


def normal_size(pull: Vector, information: Vector, variance: Vector | float) -> Vector:
    """Log evidence of terms whose size is normal around zero."""
    grown = 1.0 + information * variance
    return 0.5 * pull**2 * variance / grown - 0.5 * np.log(grown)


def best_size(pull: Vector, information: Vector, variance: Vector | float = np.inf) -> Vector:
    """Most likely size of each term for itself, with a normal prior."""
    return pull / np.maximum(information + 1.0 / np.asarray(variance), 1e-300)


@dataclass(frozen=True, slots=True)
class _Applied:
    """A matrix that is known by what it does to a vector, as `scipy.sparse.linalg` wants it."""

    shape: tuple[int, int]
    matvec: Callable[[Vector], Vector]
    dtype: type[np.float64] = np.float64


@dataclass(frozen=True, slots=True, eq=False)
class NormalPriors:
    """Normal priors of terms and their information, factored once for any pull.

    Args:
        used: Terms that have a variance.
        scale: Their prior standard deviations.
        factor: Cholesky factor of 1 + scale · information · scale.
    """

    used: Indices
    scale: Vector
    factor: tuple[Matrix, bool]

    @classmethod
    def of(cls, information: Matrix, variance: Vector) -> "NormalPriors":
        """Factor.

        Args:
            information: Shape (k, k).
            variance: Shape (k,), zero for those that are left out.
        """
        used = np.flatnonzero(variance > 0.0)
        scale = np.sqrt(variance[used])
        inner = scale[:, None] * information[np.ix_(used, used)] * scale
        inner[np.diag_indices_from(inner)] *= 1.0 + ROUNDING
        inner[np.diag_indices_from(inner)] += 1.0
        factor = cho_factor(inner, lower=True) if len(used) else (inner, True)
        return cls(used, scale, factor)

    def evidence(self, pull: Vector) -> float:
        """Log evidence of the terms over none at all, given their pull, shape (k,)."""
        if not len(self.used):
            return 0.0
        scaled = self.scale * pull[self.used]
        return 0.5 * float(scaled @ cho_solve(self.factor, scaled)) - self._width

    @property
    def _width(self) -> float:
        """Logarithm of the priors' volume over that of the posterior."""
        return float(np.sum(np.log(np.diag(self.factor[0]))))

    def log_density(self, mean: Vector) -> float:
        """What the terms add to the log density of what they leave at their mean.

        Args:
            mean: Posterior mean, shape (k,).
        """
        if not len(self.used):
            return 0.0
        return -0.5 * float(np.sum((mean[self.used] / self.scale) ** 2)) - self._width

    def mean(self, pull: Vector) -> Vector:
        """Posterior mean of every size, shape (k,), given their pull, shape (k,)."""
        found = np.zeros(len(pull))
        if len(self.used):
            scaled = self.scale * pull[self.used]
            found[self.used] = self.scale * cho_solve(self.factor, scaled)
        return found

    def exact_mean(
        self, pull: Vector, informed: Callable[[Vector], Vector], enough: float, most: int
    ) -> Vector:
        """Posterior mean where the information is told exactly and the factor is that of another.

        Conjugate gradients in the coordinates in which the other information is one
        (`scipy.sparse.linalg.cg`).

        Args:
            pull: Of the terms, shape (k,).
            informed: Exact information times sizes, shape (k,) of (k,).
            enough: Nats that the next step may still gain.
            most: Steps.
        """
        if not len(self.used):
            return np.zeros(len(pull))
        root, count = np.tril(self.factor[0]), len(self.used)

        def sizes(along: Vector) -> Vector:
            found = np.zeros(len(pull))
            found[self.used] = self.scale * solve_triangular(root, along, trans=1, lower=True)
            return found

        def apply(along: Vector) -> Vector:
            its = sizes(along)
            told = self.scale * informed(its)[self.used] + its[self.used] / self.scale
            return solve_triangular(root, told, lower=True)

        wanted = solve_triangular(root, self.scale * pull[self.used], lower=True)
        operator = aslinearoperator(_Applied((count, count), apply))
        found, _ = cg(operator, wanted, rtol=0.0, atol=float(np.sqrt(enough)), maxiter=most)
        return sizes(found)

    def covariance(self, count: int) -> Matrix:
        """Posterior covariance of the sizes of all `count` terms, shape (count, count)."""
        found = np.zeros((count, count))
        if len(self.used):
            inverse, _ = _POTRI(self.factor[0], lower=True)
            whole = np.tril(inverse) + np.tril(inverse, -1).T
            found[np.ix_(self.used, self.used)] = self.scale[:, None] * whole * self.scale
        return found

    def taken(self, cross: Matrix) -> Vector:
        """Information that these terms, marginalised, take of others, each for itself.

        Args:
            cross: Between these and them, shape (k, k').

        Returns:
            Shape (k',).
        """
        if not len(self.used):
            return np.zeros(cross.shape[1])
        seen = self.scale[:, None] * cross[self.used]
        along = solve_triangular(self.factor[0], seen, lower=True, check_finite=False)
        return np.asarray(np.sum(along**2, axis=0))

    def beyond(self, information: Matrix, cross: Matrix) -> Matrix:
        """Information of other terms, with these marginalised.

        Args:
            information: Of k' other terms, these being absent, shape (k', k').
            cross: Between these and them, shape (k, k').
        """
        if not len(self.used):
            return information
        seen = self.scale[:, None] * cross[self.used]
        return information - seen.T @ cho_solve(self.factor, seen)


@dataclass(frozen=True, slots=True, eq=False)
class NormalTerms:
    """Terms with normal priors, taken all at once.

    Args:
        pull: b, shape (k,).
        information: G, shape (k, k).
        variance: Λ, shape (k,), zero for those that are left out.
    """

    pull: Vector
    information: Matrix
    variance: Vector

    @property
    def used(self) -> Indices:
        """Terms that have a variance."""
        return np.flatnonzero(self.variance > 0.0)

    def evidence(self) -> float:
        """Log evidence over no term at all."""
        return NormalPriors.of(self.information, self.variance).evidence(self.pull)

    def mean(self) -> Vector:
        """Posterior mean of every size, shape (k,)."""
        return NormalPriors.of(self.information, self.variance).mean(self.pull)

    def cost(self, sizes: Vector) -> float:
        """What the log likelihood with some sizes, shape (k,), is more than the evidence [nats]."""
        return -NormalPriors.of(self.information, self.variance).log_density(sizes)

    def held(self, first: float) -> Vector:
        """Posterior mean of every size, shape (k,), where the first one has a given size."""
        mean = self.mean()
        known = self.information + np.diag(1.0 / self.variance)
        others = np.linalg.solve(known[1:, 1:], known[1:, 0]) * (first - mean[0])
        return np.concatenate([[first], mean[1:] - others])

    def evidence_at(self, sizes: Vector) -> float:
        """Log evidence, less what is lost with these sizes, shape (k,), in place of the best."""
        beyond = sizes - self.mean()
        lost = beyond @ self.information @ beyond + np.sum(beyond**2 / self.variance)
        return self.evidence() - 0.5 * float(lost)
