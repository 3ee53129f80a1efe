"""The newest rows, which are not yet taken in for good: one chunk that grows.

Where the RF follows an energy that drifts, the drift moves the orbit at every tick as a step of
the RF does. It is known: over a chunk it is minus what RF and correctors have changed of the
energy, for the loop keeps the orbit. So the regressor of the RF is its step less that mean. In a
chunk without a step nothing is taken off.
"""

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.estimation.statistics import StepSpectrum, StepStatistics


class Tail:
    """Rows of the chunk that is open.

    Args:
        first: What is taken off the differences, shape (n, k): R̂₀ in modes and the creep.
        energy: What the correctors' changes do to the energy in units of the RF's regressor, which
            follows them, shape (m,); None: there is none.

    Attributes:
        spectrum: Of all its rows; None while there is none.
    """

    def __init__(self, first: Vector, energy: Vector | None = None) -> None:
        self._first, self._energy = first, energy
        modes, coefficients = first.shape
        self._changes = np.zeros((0, coefficients))
        self._differences = np.zeros((0, modes))
        self._starts = np.zeros(0, dtype=np.bool_)
        self.spectrum: StepSpectrum | None = None

    def __len__(self) -> int:
        return len(self._changes)

    def push(self, changes: Vector, differences: Vector, starts: Mask) -> None:
        """Add rows.

        Args:
            changes: Regressors, shape (T, k).
            differences: Of readings, in modes, shape (T, n) [m].
            starts: Whether a row does not continue the one before it, shape (T,).
        """
        self._changes = np.concatenate([self._changes, changes])
        self._differences = np.concatenate([self._differences, differences])
        self._starts = np.concatenate([self._starts, starts])
        regressors = self._with_drift()
        left = self._differences - regressors @ self._first.T
        self.spectrum = StepSpectrum.of(regressors, left, self._starts)

    def statistics(self) -> StepStatistics:
        """Sum its rows up."""
        statistics = StepStatistics(*self._first.shape[::-1])
        if self.spectrum is not None:
            statistics.take(self.spectrum)
        return statistics

    def _with_drift(self) -> Vector:
        """Add the drift of the energy to the steps of the RF, if there were any."""
        regressors, energy = self._changes, self._energy
        if energy is None or not regressors[:, len(energy)].any():
            return regressors
        found, m = regressors.copy(), len(energy)
        found[:, m] -= np.mean(found[:, m] + found[:, :m] @ energy)
        return found
