"""Kalman innovations of "random-walk orbit + white reading noise", mode by mode, and their adjoint.

What a model leaves of a record, z = reading − prediction, is in every mode of the noise a random
walk (variance q per tick) under white noise (variance r²). Its one-step prediction errors

    e_k = z_k − z_{k−1} + (1 − L) e_{k−1},   variance S = r² / (1 − L) in the steady state,

are white if the model is right; the sum of their log densities is the log-likelihood of the model.
Every stretch begins with an orbit that is not known at all (diffuse start: L = 1), so its first
row predicts nothing. Because e is linear in z, one backward pass gives the derivative of the
log-likelihood by every prediction (B. D. O. Anderson and J. B. Moore, Optimal Filtering, ch. 5;
F. C. Schweppe, IEEE Trans. Inf. Theory 11 (1965) 61).
"""

from dataclasses import dataclass, field

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.noise_modes import NoiseModes
from orbitfb.physics.optics import Matrix

OLDEST = 3000
"""Rows after which the gain of every mode is taken as steady."""
LEAST_MEMORY = 1e-9
"""Share of the row before that a filter keeps at least, however still its readings are."""


@dataclass(frozen=True, slots=True, eq=False)
class NoiseFloor:
    """The noise that is nobody's fault.

    Args:
        modes: In which it is uncorrelated.
        reading: Variance of the usual BPM's reading noise, r² [m²].
        walk: Variance q of the random walk's step in every mode, shape (n,) [m²].
    """

    modes: NoiseModes
    reading: float
    walk: Vector
    _feedback: Matrix = field(init=False, repr=False)
    _deviation: Matrix = field(init=False, repr=False)

    def __post_init__(self) -> None:
        ratio = self.walk / self.reading
        feedback = np.zeros((OLDEST, len(ratio)))
        variance = np.ones((OLDEST, len(ratio)))
        filtered = np.ones(len(ratio))  # of the orbit's estimate, after the first reading, over r²
        for age in range(1, OLDEST):
            predicted = filtered + ratio
            variance[age] = predicted + 1.0
            filtered = predicted / variance[age]
            feedback[age] = 1.0 - filtered
        object.__setattr__(self, "_feedback", feedback)
        object.__setattr__(self, "_deviation", np.sqrt(variance * self.reading))

    @property
    def gains(self) -> Vector:
        """Steady Kalman gain L of every mode, shape (n,)."""
        return 1.0 - self._feedback[-1]

    @property
    def innovation_variance(self) -> Vector:
        """Steady variance S of every mode's innovation, shape (n,) [m²]."""
        return self._deviation[-1] ** 2

    def feedback_of(self, rows: int) -> Matrix:
        """1 − L by which the row before counts in every row of a stretch, shape (rows, n)."""
        return self._feedback[np.minimum(np.maximum(np.arange(rows) - 1, 0), OLDEST - 1)]

    def deviation_of(self, rows: int) -> Matrix:
        """√S of every row of a stretch, shape (rows, n) [m]."""
        return self._deviation[np.minimum(np.arange(rows), OLDEST - 1)]

    def to_modes(self, columns: Matrix) -> Matrix:
        """Turn orbits [m] into modes [m], shape (…, n)."""
        return columns @ self.modes.directions

    def seen(self, patterns: Matrix) -> Matrix:
        """Patterns (n, P) in the modes, over the steady √S of each, shape (n, P)."""
        modal = self.modes.directions.T @ patterns
        modal /= np.sqrt(self.innovation_variance)[:, None]
        return modal

    def to_bpms(self, columns: Matrix) -> Matrix:
        """Turn modes [m] into orbits [m], the inverse of `to_modes`, shape (…, n)."""
        return (columns @ self.modes.axes.T) * self.modes.spread

    def by_bpm(self, white: Matrix) -> Matrix:
        """Rotate rows of unit variance from modes to BPMs, of unit variance too, shape (…, n)."""
        return white @ self.modes.axes.T

    @property
    def readings(self) -> Vector:
        """Variance of every BPM's reading noise, shape (n,) [m²]."""
        return self.reading * self.modes.spread**2

    def mean_square(self, variances: Vector) -> float:
        """Mean square over the BPMs of an orbit whose modes have these variances [m²]."""
        return float(np.mean((self.modes.axes**2 @ variances) * self.modes.spread**2))

    def innovations(self, left: Matrix, starts: Mask) -> tuple[Matrix, Matrix]:
        """Predict every row from those before it.

        Args:
            left: z, rows of the BPMs' space, shape (N, n) [m].
            starts: Where stretches begin, shape (N,).

        Returns:
            e in the modes and its standard deviation √S, each of shape (N, n) [m]; e is zero in
            the first row of every stretch.
        """
        return self._predicted(self.to_modes(left), starts)

    def _predicted(self, z: Matrix, starts: Mask) -> tuple[Matrix, Matrix]:
        innovation = np.zeros_like(z)
        innovation[1:] = z[1:] - z[:-1]
        innovation[starts] = 0.0
        deviation = np.empty_like(z)
        for stretch in stretches(starts):
            self._run(innovation[stretch], deviation[stretch])
        return innovation, deviation

    def whiten(self, left: Matrix, starts: Mask) -> Matrix:
        """Turn what a model leaves into innovations of unit variance, in the modes, (N, n)."""
        return self.whiten_modes(self.to_modes(left), starts)

    def whiten_modes(self, z: Matrix, starts: Mask) -> Matrix:
        """As `whiten`, of what is left in the modes, (N, n) [m]."""
        innovation, deviation = self._predicted(z, starts)
        innovation /= deviation
        return innovation

    def _run(self, innovation: Matrix, deviation: Matrix) -> None:
        """Filter one stretch in place; row 0 is zero."""
        rows = min(len(innovation), OLDEST)
        deviation[:rows] = self._deviation[:rows]
        deviation[rows:] = self._deviation[-1]
        for row in range(1, rows):
            innovation[row] += self._feedback[row - 1] * innovation[row - 1]
        if len(innovation) > rows:
            steady = self._feedback[-1]
            before = innovation[rows - 1]
            for row in range(rows, len(innovation)):
                innovation[row] += steady * before
                before = innovation[row]

    def adjoint(self, white: Matrix, starts: Mask) -> Matrix:
        """Give the derivative of Σ ½ white² … by the predictions: Fᵀ of `whiten`.

        Args:
            white: Rows in the modes, as `whiten` gives them, shape (N, n).
            starts: Where stretches begin, shape (N,).

        Returns:
            λ in the BPMs' space, shape (N, n) [1/m]: Σ λ δ is the first-order change of the
            log-likelihood when the prediction changes by δ, if `white` are the innovations.
        """
        total = np.zeros_like(white)
        for stretch in stretches(starts):
            rows = stretch.stop - stretch.start
            ages = np.minimum(np.arange(rows), OLDEST - 1)
            piece = white[stretch] / self._deviation[ages]
            piece[0] = 0.0
            for row in range(rows - 2, 0, -1):
                piece[row] += self._feedback[min(row, OLDEST - 1)] * piece[row + 1]
            total[stretch] = piece
            total[stretch.start : stretch.stop - 1] -= piece[1:]
        return total @ self.modes.directions.T

    def log_density_terms(self, starts: Mask) -> Vector:
        """Give −Σ log √(2π S) over the modes, of every row, shape (N,); zero where none counts."""
        count = len(self.modes.spread)
        constant = -np.sum(np.log(self._deviation), axis=1) - 0.5 * count * np.log(2 * np.pi)
        constant -= np.sum(np.log(self.modes.spread))
        terms = np.empty(len(starts))
        for stretch in stretches(starts):
            ages = np.minimum(np.arange(stretch.stop - stretch.start), OLDEST - 1)
            terms[stretch] = constant[ages]
            terms[stretch.start] = 0.0
        return terms


def stretches(starts: Mask) -> list[slice]:
    """List the stretches of a record by where they begin."""
    begins = np.flatnonzero(starts)
    return [
        slice(int(begin), int(end))
        for begin, end in zip(begins, [*begins[1:], len(starts)], strict=True)
    ]
