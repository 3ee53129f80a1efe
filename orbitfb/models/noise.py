"""Estimate the loop's noise from its own innovations: one reading noise, a ground per mode.

Reading noise is white over the BPMs, so that every mode has the same variance r² of it;
ground motion is collective, so that every mode has its own. The Kalman gain L of a mode ties
them: its innovations have the variance r² / (1 − L). Knowing r² from all the modes makes the
gain of each one far better known than its own autocorrelation would.
"""

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Vector
from orbitfb.models.filter import ground_ratio, innovation_ratio

LADDER = np.array([0.01, 0.025, 0.05, 0.09, 0.14, 0.2, 0.28, 0.38, 0.5, 0.64, 0.78, 0.9])
"""Kalman gains that a mode can have."""

_PASSES = 8


class NoiseEstimate:
    """Running estimate of the reading noise and of every mode's Kalman gain.

    Args:
        modes: Number of modes n.
        reading_noise: What to believe at first, rms [m].
        ground: What to believe at first, rms of the orbit's step per tick [m].
        memory: Rows after which an old innovation counts 1/e.
        belief: Rows that the first belief is worth.
    """

    def __init__(
        self, modes: int, reading_noise: float, ground: float, memory: float, belief: float
    ) -> None:
        self.reading_variance = reading_noise**2
        gain = LADDER[np.argmin(np.abs(ground_ratio(LADDER) - (ground / reading_noise) ** 2))]
        self.levels: NDArray[np.intp] = np.full(modes, np.argmin(np.abs(LADDER - gain)))
        self._memory = memory
        self._rows = belief
        self._believed = self.reading_variance * _misfit(gain, LADDER)
        self._squares = np.repeat(self._believed[:, None] * belief, modes, axis=1)

    @property
    def innovation_variances(self) -> Vector:
        """Variance of the innovations of a mode at every level of the ladder, shape (G,) [m²]."""
        return self.reading_variance * innovation_ratio(LADDER)

    @property
    def ground_variances(self) -> Vector:
        """Variance of the orbit's step in every mode, shape (n,) [m²]."""
        return self.reading_variance * ground_ratio(LADDER)[self.levels]

    def absorb(self, squares: Vector, rows: float) -> None:
        """Take in sums of squared innovations and estimate anew.

        Args:
            squares: Sum over rows for every level and mode, shape (G, n) [m²].
            rows: How many rows they are.
        """
        fade = np.exp(-rows / self._memory)
        self._squares = fade * self._squares + squares
        self._rows = fade * self._rows + rows
        variances = self._squares / self._rows
        columns = np.arange(variances.shape[1])
        for _ in range(_PASSES):
            expected = self.innovation_variances[:, None]
            self.levels = np.argmin(np.log(expected) + variances / expected, axis=0)
            whitened = variances[self.levels, columns] * (1.0 - LADDER[self.levels])
            self.reading_variance = float(np.mean(whitened))


def _misfit(truth: float, gains: Vector) -> Vector:
    """Innovation variance over r² when a mode of gain `truth` is filtered with other gains.

    The difference of readings is a moving average (1 − (1 − L) z⁻¹) ε with variance r²/(1 − L)
    of ε; the filter with gain M divides by (1 − (1 − M) z⁻¹).
    """
    zero, pole = 1.0 - truth, 1.0 - gains
    return (1.0 + (pole - zero) ** 2 / (1.0 - pole**2)) / (1.0 - truth)
