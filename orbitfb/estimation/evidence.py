"""Evidence of terms that add to the steps: closed forms.

A term h adds size · s_h to the transformed steps, s_h = pattern ⊗ course. With
its pull a_h = Σ_f s_hᵀ Ω_f z_f and its information H_hk = Σ_f s_hᵀ Ω_f s_k the log likelihood ratio
to having no term is

    given size θ:              a θ − ½ H θ²
    size normal, variance v:   ½ a² v / (1 + H v) − ½ ln(1 + H v)
    many at once, variances Λ: ½ bᵀ(Λ⁻¹ + G)⁻¹ b − ½ ln |1 + Λ G|
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from orbitfb.core.signals import Vector
from orbitfb.estimation.transform import Indices, Matrix


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

    def _factor(self) -> tuple[tuple[Matrix, bool], Vector]:
        used = self.used
        scale = np.sqrt(self.variance[used])
        inner = scale[:, None] * self.information[np.ix_(used, used)] * scale
        inner[np.diag_indices_from(inner)] += 1.0
        return cho_factor(inner, lower=True), scale

    def evidence(self) -> float:
        """Log evidence over no term at all."""
        if not len(self.used):
            return 0.0
        (factor, lower), scale = self._factor()
        pull = scale * self.pull[self.used]
        square = float(pull @ cho_solve((factor, lower), pull))
        return 0.5 * square - float(np.sum(np.log(np.diag(factor))))

    def mean(self) -> Vector:
        """Posterior mean of every size, shape (k,)."""
        found = np.zeros(len(self.pull))
        if len(self.used):
            factor, scale = self._factor()
            found[self.used] = scale * cho_solve(factor, scale * self.pull[self.used])
        return found

    def beyond(self, pull: Vector, information: Matrix, cross: Matrix) -> tuple[Vector, Matrix]:
        """Pull and information of other terms, with these marginalised.

        Args:
            pull: Of k' other terms, these being absent, shape (k',).
            information: Of them, shape (k', k').
            cross: Between these and them, shape (k, k').
        """
        used = self.used
        if not len(used):
            return pull, information
        factor, scale = self._factor()
        seen = scale[:, None] * cross[used]
        solved = cho_solve(factor, seen)
        return pull - solved.T @ (scale * self.pull[used]), information - seen.T @ solved
