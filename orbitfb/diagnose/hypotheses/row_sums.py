"""Sums over rows instead of frequencies: what begins late is weighed from its beginning on."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from orbitfb.core.signals import Vector
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.estimation.transform import Indices, Matrix


@dataclass(frozen=True, slots=True, eq=False)
class OwnError:
    """The healthy error of some devices, each for itself.

    Args:
        first: Number of the first of its columns among all errors.
        spectrum: Transformed steps of its courses, shape (T, k).
        steps: The same from row to row, shape (T, k).
        variance: Of its size before the record is seen, shape (k,).
        information: Of its size, shape (k,).
    """

    first: int
    spectrum: Single
    steps: Matrix
    variance: Vector
    information: Vector

    def marginal(self, information: Vector, cross: Vector) -> Vector:
        """Information of other courses of the devices with the error marginalised."""
        known = np.where(self.variance > 0.0, 1.0 / np.maximum(self.variance, 1e-300), np.inf)
        return np.maximum(information - cross**2 / (known + self.information), 0.0)


def whitened_by(steps: Matrix, root: float) -> Matrix:
    """Innovations of steps whose moving average has a root: ε_n = Δ_n + r ε_{n−1}."""
    return np.asarray(lfilter([1.0], [1.0, -root], steps, axis=0))


def moving_root(ratio: Vector) -> Vector:
    """Root r of the moving average that the steps of a walk and its noise are.

    Its covariance q + 2 at lag 0 and −1 at lag 1 is (1 + r²)/r and −1.

    Args:
        ratio: q, walk over noise.
    """
    return 1.0 + ratio / 2.0 - np.sqrt(ratio + ratio**2 / 4.0)


def sums_since(values: Matrix, onsets: Indices) -> Matrix:
    """Sums from every onset to the end, shape (O, D)."""
    parts = np.add.reduceat(values, onsets, axis=0)
    return np.cumsum(parts[::-1], axis=0)[::-1]
