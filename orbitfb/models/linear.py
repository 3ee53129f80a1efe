"""The linear model of the ring, x' = x + R̂ a, with what is not known about R̂."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Vector
from orbitfb.models.column import RfColumn


@dataclass(frozen=True, slots=True)
class LinearModel:
    """A response matrix with its uncertainty and the noise around it.

    The rows of UᵀR (U: the modes) are independent and normal. Modes of one level share the
    covariance of their row.

    Args:
        response: R̂, shape (n, m) [m/A].
        modes: U, orthonormal columns, shape (n, n).
        levels: Level of every mode, shape (n,).
        covariances: Covariance of a row of UᵀR at every level, shape (G, m, m) [(m/A)²].
        reading_variance: Variance of the reading noise of a BPM [m²].
        ground_variances: Variance of the orbit's random step in every mode, shape (n,) [m²].
        creep: Steady motion of the orbit in every mode, shape (n,) [m/tick].
        rf: What is known of the RF column; None: the RF does not step.
    """

    response: Vector
    modes: Vector
    levels: NDArray[np.intp]
    covariances: Vector
    reading_variance: float
    ground_variances: Vector
    creep: Vector
    rf: RfColumn | None = None

    def predict(self, orbit: Vector, change: Vector) -> Vector:
        """Predict the next orbit, shape (n,) [m], from an orbit [m] and a change (m,) [A]."""
        return orbit + self.response @ change

    @property
    def row_covariance(self) -> Vector:
        """Covariance of a row of R̂, mean over the rows, shape (m, m) [(m/A)²]."""
        counts = np.bincount(self.levels, minlength=len(self.covariances)) / len(self.levels)
        return np.tensordot(counts, self.covariances, axes=1)

    def sample(self, generator: np.random.Generator) -> Vector:
        """Draw a response that the data allow, shape (n, m) [m/A]."""
        return next(self.samples(generator))

    def samples(self, generator: np.random.Generator) -> Iterator[Vector]:
        """Draw responses that the data allow one after another, each of shape (n, m) [m/A]."""
        factors = [
            (self.levels == level, np.linalg.cholesky(self.covariances[level]).T.astype(np.float32))
            for level in np.unique(self.levels)
        ]
        modes = self.modes.astype(np.float32)  # what is drawn at random needs no more digits
        while True:
            rows = generator.standard_normal(self.response.shape).astype(np.float32)
            error = np.empty_like(rows)
            for members, factor in factors:
                error[members] = rows[members] @ factor
            yield self.response + modes @ error

    def normalised_errors(self, response: Vector) -> Vector:
        """Errors against a known response in units of the stated uncertainty.

        Args:
            response: The true R, shape (n, m) [m/A].

        Returns:
            Shape (n, m), by mode and by principal direction of the covariance; independent
            standard normal numbers when the stated uncertainty is right.
        """
        error = self.modes.T @ (self.response - response)
        whitened = np.empty_like(error)
        for level in np.unique(self.levels):
            members = self.levels == level
            values, directions = np.linalg.eigh(self.covariances[level])
            whitened[members] = (error[members] @ directions) / np.sqrt(values)
        return whitened


def excited_gain(estimate: Vector, response: Vector, changes: Vector) -> float:
    """Slope of an estimate on the true response over the directions that were excited.

    The regression of R̂a on Ra through the origin, over the changes that were applied:
    trace(R̂ M Rᵀ) / trace(R M Rᵀ) with M the second moment of a. 1 when R̂ = R.

    Args:
        estimate: R̂, shape (n, m) [m/A].
        response: R, shape (n, m) [m/A].
        changes: Applied changes, shape (T, m) [A].
    """
    moment = changes.T @ changes
    moved = response @ moment
    return float(np.sum(estimate * moved) / np.sum(response * moved))
