"""The newest rows, which are not yet taken in for good: one chunk that grows."""

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.estimation.statistics import StepSpectrum, StepStatistics


class Tail:
    """Rows of the chunk that is open.

    Args:
        coefficients: Count k of regressors.
        modes: Count n.

    Attributes:
        spectrum: Of all its rows; None while there is none.
    """

    def __init__(self, coefficients: int, modes: int) -> None:
        self._changes = np.zeros((0, coefficients))
        self._steps = np.zeros((0, modes))
        self._starts = np.zeros(0, dtype=np.bool_)
        self.spectrum: StepSpectrum | None = None

    def __len__(self) -> int:
        return len(self._changes)

    def push(self, changes: Vector, steps: Vector, starts: Mask) -> None:
        """Add rows.

        Args:
            changes: Regressors, shape (T, k).
            steps: What R̂₀ does not explain, in modes, shape (T, n) [m].
            starts: Whether a row does not continue the one before it, shape (T,).
        """
        self._changes = np.concatenate([self._changes, changes])
        self._steps = np.concatenate([self._steps, steps])
        self._starts = np.concatenate([self._starts, starts])
        self.spectrum = StepSpectrum.of(self._changes, self._steps, self._starts)

    def statistics(self) -> StepStatistics:
        """Sum its rows up."""
        statistics = StepStatistics(self._changes.shape[1], self._steps.shape[1])
        if self.spectrum is not None:
            statistics.take(self.spectrum)
        return statistics
