"""The newest rows, which are not yet taken in for good: one chunk that grows.

While the RF follows an energy that drifts, the drift moves the orbit at every tick as a step of
the RF does, and nobody knows how fast it is. So in a chunk in which the RF stepped, and in the one
after it, the means are taken off changes, steps and differences: what is the same at every tick
tells nothing there. Other chunks are left as they are.
"""

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.estimation.statistics import StepSpectrum, StepStatistics


class Tail:
    """Rows of the chunk that is open.

    Args:
        first: What is taken off the differences, shape (n, k): R̂₀ in modes and the creep.
        rf: Which regressor is the step of the RF; None: none is.
        before: The chunk before; None: there was none.

    Attributes:
        spectrum: Of all its rows; None while there is none.
    """

    def __init__(self, first: Vector, rf: int | None = None, before: "Tail | None" = None) -> None:
        self._first, self._rf = first, rf
        self._follows = before is not None and before.stepped
        modes, coefficients = first.shape
        self._changes = np.zeros((0, coefficients))
        self._differences = np.zeros((0, modes))
        self._starts = np.zeros(0, dtype=np.bool_)
        self.spectrum: StepSpectrum | None = None

    def __len__(self) -> int:
        return len(self._changes)

    @property
    def stepped(self) -> bool:
        """Whether the RF stepped in it."""
        return self._rf is not None and bool(self._changes[:, self._rf].any())

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
        regressors, left = self._changes, self._differences
        if self._follows or self.stepped:
            mean = np.mean(regressors, axis=0)
            mean[-1] = 0.0  # the creep stays
            regressors, left = regressors - mean, left - np.mean(left, axis=0)
        left = left - regressors @ self._first.T
        self.spectrum = StepSpectrum.of(regressors, left, self._starts)

    def statistics(self) -> StepStatistics:
        """Sum its rows up."""
        statistics = StepStatistics(*self._first.shape[::-1])
        if self.spectrum is not None:
            statistics.take(self.spectrum)
        return statistics
