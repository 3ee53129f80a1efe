"""The gain that fits what is known of R: cautious, and renewed when the readings call for it.

The change that minimises the expected squares of the next orbit, each mode weighed by w_i, is

    a = −K x̂,   K = (Σ_i w_i (R̂_i R̂_iᵀ + P_i))⁻¹ Σ_i w_i R̂_i U_iᵀ,

R̂_i a row of UᵀR̂ and P_i its covariance, which takes the place of a regularisation. The weight
is the time that a mode takes to fall, w_i = 1 / (share of it that a tick corrects): the fixed
point, mode by mode, of the Riccati equation of a system with random coefficients.

Far from the floor, after a kick, that is the law. At the floor (`near`) the changes are so small
that what they do by mistake to the strong modes is lost among what those do by themselves, while
caution about it would cost control of the weak ones: so there only the doubt about the rows of
the weakest modes counts, and every weight is 1.

Source: Åström and Wittenmark, Adaptive Control, ch. 7 (cautious control); de Koning, Automatica 18
(1982) 443 (optimal control with random coefficients).
"""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.estimation.recursive.estimate import RecursiveResponse
from orbitfb.estimation.recursive.said import Innovation
from orbitfb.estimation.recursive.settings import CautionSettings

_FIRST_ROUNDS = 3


class CautiousGain:
    """The gains near the floor and far from it, kept up to date.

    Args:
        estimate: The running estimate of R; it is fed by somebody else.
        settings: Caution, and when to renew.

    Attributes:
        near: K at the floor, shape (m, n) [A/m].
        far: K after a kick, shape (m, n) [A/m].
        swaps: How often a gain was renewed.
    """

    def __init__(self, estimate: RecursiveResponse, settings: CautionSettings) -> None:
        self._estimate = estimate
        self._settings = settings
        self._weights = np.ones(len(estimate.modes))
        self._age = 0
        self._was_far = True
        self.swaps = 0
        self.near = self._solve_near()
        self.far = self._solve_far(_FIRST_ROUNDS)

    @property
    def far_from_floor(self) -> float:
        """Where the far gain begins, in units of what the noise makes expect [1]."""
        return self._settings.far

    @property
    def is_far(self) -> bool:
        """Whether the filtered orbit is far from the floor."""
        return self._estimate.deviation > self._settings.far

    def follow(self, innovation: Innovation, both: bool = False) -> bool:
        """Renew the gain if it is time.

        Args:
            innovation: What the last reading said.
            both: Whether both gains are wanted, and not only the one for where the orbit is.

        Returns:
            Whether there is a new gain.
        """
        settings = self._settings
        far = self.is_far
        self._age += 1
        called = settings.events and (
            innovation.chi2 > settings.chi2
            or innovation.doubt > settings.doubt
            or far != self._was_far
        )
        if not called and self._age < settings.period:
            return False
        if far or both:
            self.far = self._solve_far(2 if far and not self._was_far else 1)
        if not far or both:
            self.near = self._solve_near()
        self._was_far = far
        self._age = 0
        self.swaps += 1
        return True

    def _solve_near(self) -> Vector:
        rows = self._estimate.rows
        doubt = len(self._weights) * self._estimate.weakest_covariance()
        return self._solve(rows, rows, doubt) @ self._estimate.modes.T

    def _solve_far(self, rounds: int) -> Vector:
        rows = self._estimate.rows
        inverse = np.empty_like(rows)
        for _ in range(rounds):
            weighted = rows * self._weights
            doubt = self._estimate.weighted_covariance(self._weights)
            inverse = self._solve(rows, weighted, doubt)
            corrected = np.einsum("mn,mn->n", rows, inverse)
            self._weights = 1.0 / np.clip(corrected, 1.0 / self._settings.longest, 1.0)
        return inverse @ self._estimate.modes.T

    def _solve(self, rows: Vector, weighted: Vector, doubt: Vector) -> Vector:
        from scipy.linalg import cho_factor, cho_solve  # half a second of a loop that never learns

        squared = weighted @ rows.T
        squared += self._settings.caution * doubt
        squared.flat[:: len(squared) + 1] += self._settings.regularisation**2
        try:
            factor = cho_factor(squared, lower=True, check_finite=False)
        except np.linalg.LinAlgError:  # without any doubt a mode of no strength has no inverse
            return _pseudo_inverse(squared) @ weighted
        return cho_solve(factor, weighted, check_finite=False)


def _pseudo_inverse(matrix: Vector) -> Vector:
    values, vectors = np.linalg.eigh(matrix)
    kept = values > len(values) * np.finfo(np.float64).eps * values[-1]
    return (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
