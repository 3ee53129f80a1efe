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

A mode whose response drifts through zero while it holds a current asks for ever more of it, and no
doubt restrains that. So what a corrector holds, h_j since the loop closed, has a price that grows
faster than its square, p_j = λ² h_j² / 2 + ν² h_j⁴ / 4, and the change is Newton's step for the
sum of both:

    a = −G (Σ_i w_i R̂_i U_iᵀ x̂ + p′),   G = (Σ_i w_i (R̂_i R̂_iᵀ + P_i) + diag p″)⁻¹.

Where an orbit d of one mode needs more current than the correctors should give, the orbit gives
way: of σ (d − σ h) = p′(h) no response σ makes more than h = √(d / ν).

Source: Åström and Wittenmark, Adaptive Control, ch. 7 (cautious control); de Koning, Automatica 18
(1982) 443 (optimal control with random coefficients).
"""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.estimation.recursive.estimate import RecursiveResponse
from orbitfb.estimation.recursive.said import Innovation
from orbitfb.estimation.recursive.settings import CautionSettings

_FIRST_ROUNDS = 3
_OUTGROWN = 2.0
"""Growth of p″ since a gain was made, from which it is renewed at once [1]. A Newton step with half
of the second derivative goes twice as far as it should, and does not converge."""


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    """What minimises the squares.

    Args:
        gain: K on the orbit in modes, shape (m, n) [A/m].
        inverse: G, shape (m, m) [1/R²].
        bend: p″, shape (m,) [R²].
    """

    gain: Vector
    inverse: Vector
    bend: Vector


class CautiousGain:
    """The gains near the floor and far from it, kept up to date.

    Args:
        estimate: The running estimate of R; it is fed by somebody else.
        settings: Caution, and when to renew.

    Attributes:
        held: Currents since it was made, shape (m,) [A].
        back: What of them the price gives back at the next tick, G p′, shape (m,) [A].
        swaps: How often a gain was renewed.
    """

    def __init__(self, estimate: RecursiveResponse, settings: CautionSettings) -> None:
        self._estimate = estimate
        self._settings = settings
        self._weights = np.ones(len(estimate.modes))
        self._near_age, self._far_age = 0, settings.period // 2
        self._was_far = True
        self._on_readings: dict[str, Vector] = {}
        self.swaps = 0
        self.held = self.back = np.zeros(len(estimate.rows))
        self._bend, self._outgrown = np.full(len(self.held), settings.regularisation**2), False
        self._near, self._far = self._solve_near(), self._solve_far(_FIRST_ROUNDS)

    @property
    def near_modes(self) -> Vector:
        """K at the floor, on the orbit in modes, shape (m, n) [A/m]."""
        return self._near.gain

    @property
    def far_modes(self) -> Vector:
        """K after a kick, the same way."""
        return self._far.gain

    @property
    def near(self) -> Vector:
        """K at the floor, shape (m, n) [A/m]."""
        return self._on_reading("near", self.near_modes)

    @property
    def far(self) -> Vector:
        """K after a kick, shape (m, n) [A/m]."""
        return self._on_reading("far", self.far_modes)

    @property
    def far_from_floor(self) -> float:
        """Where the far gain begins, in units of what the noise makes expect [1]."""
        return self._settings.far

    @property
    def is_far(self) -> bool:
        """Whether the filtered orbit is far from the floor."""
        return self._estimate.deviation > self._settings.far

    def hold(self, change: Vector) -> None:
        """Remember a change that was sent, shape (m,) [A]."""
        damping, price = self._settings.regularisation**2, self._settings.price**2
        self.held = self.held + change
        squared = self.held**2
        self._bend = damping + 3.0 * price * squared
        solution = self._far if self.is_far else self._near
        self.back = solution.inverse @ (self.held * (damping + price * squared))
        self._outgrown = bool((self._bend > _OUTGROWN * solution.bend).any())

    def follow(self, innovation: Innovation, both: bool = False) -> bool:
        """Renew the gain for where the orbit is, if it is time.

        Args:
            innovation: What the last reading said.
            both: Whether the other gain is wanted together with it.

        Returns:
            Whether there is a new gain.
        """
        far = self.is_far
        self._near_age += 1
        self._far_age += 1
        if not self._is_called(innovation, far) and self._age(far) < self._settings.period:
            return False
        if far or both:
            self._renew_far(2 if far and not self._was_far else 1)
        if not far or both:
            self._renew_near()
        self._was_far = far
        self.swaps += 1
        return True

    def follow_in_turn(self, innovation: Innovation) -> bool:
        """Do the same, and renew the other gain at other ticks, so that none costs two solutions.

        Args:
            innovation: What the last reading said.

        Returns:
            Whether there is a new gain.
        """
        if self.follow(innovation):
            return True
        if self._far_age >= self._settings.period:
            self._renew_far(1)
        elif self._near_age >= self._settings.period:
            self._renew_near()
        else:
            return False
        return True

    def _age(self, far: bool) -> int:
        return self._far_age if far else self._near_age

    def _is_called(self, innovation: Innovation, far: bool) -> bool:
        settings = self._settings
        return settings.events and (
            self._outgrown
            or innovation.chi2 > settings.chi2
            or innovation.doubt > settings.doubt
            or far != self._was_far
        )

    def _on_reading(self, name: str, gain: Vector) -> Vector:
        """Give a gain on the orbit of the BPMs; it is worked out when it is first asked for."""
        if name not in self._on_readings:
            self._on_readings[name] = gain @ self._estimate.modes.T
        return self._on_readings[name]

    def _renew_near(self) -> None:
        self._near = self._solve_near()
        self._on_readings.pop("near", None)
        self._near_age = 0

    def _renew_far(self, rounds: int) -> None:
        self._far = self._solve_far(rounds)
        self._on_readings.pop("far", None)
        self._far_age = 0

    def _solve_near(self) -> _Solution:
        rows = self._estimate.rows
        doubt = len(self._weights) * self._estimate.weakest_covariance()
        return self._solve(rows, np.ones(len(self._weights)), doubt)

    def _solve_far(self, rounds: int) -> _Solution:
        rows = self._estimate.rows
        doubt = self._estimate.weighted_covariance(self._weights)
        solution = self._solve(rows, self._weights, doubt)
        corrected = np.einsum("mn,mn->n", rows, solution.gain)
        self._weights = 1.0 / np.clip(corrected, 1.0 / self._settings.longest, 1.0)
        return solution if rounds == 1 else self._solve_far(rounds - 1)

    def _solve(self, rows: Vector, weights: Vector, doubt: Vector) -> _Solution:
        """Minimise the squares.

        Args:
            rows: R̂_i as columns, shape (m, n).
            weights: w_i, shape (n,).
            doubt: The sum of the covariances, shape (m, m).
        """
        half = rows * np.sqrt(weights)
        squared = half @ half.T
        squared += self._settings.caution * doubt
        squared.flat[:: len(squared) + 1] += self._bend
        inverse = _inverse(squared)
        return _Solution(inverse @ (rows * weights), inverse, self._bend)


def _inverse(squared: Vector) -> Vector:
    """The inverse of a matrix of no negative eigenvalue, shape (m, m)."""
    from scipy.linalg import get_lapack_funcs  # half a second of a loop that never learns

    decompose, invert = get_lapack_funcs(("potrf", "potri"), dtype=np.float64)
    factor, failed = decompose(squared, lower=1)
    if failed:  # without any doubt a mode of no strength has no inverse
        return _pseudo_inverse(squared)
    half, _ = invert(factor, lower=1)  # below the diagonal
    return half + np.tril(half, -1).T


def _pseudo_inverse(matrix: Vector) -> Vector:
    values, vectors = np.linalg.eigh(matrix)
    kept = values > len(values) * np.finfo(np.float64).eps * values[-1]
    return (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
