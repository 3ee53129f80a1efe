"""Windows of a record: intervals of sums over time, and the quiet ones that tell the floor."""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.estimation.transform import Indices, Matrix

WINDOWS = 12
"""Windows of a record: enough for an interval by drawing them anew, few enough that each is longer
than what its rows have in common."""

DRAWS = 400
"""Draws of an interval: its ends are then right to a tenth of its width."""

_LOW, _HIGH = 5.0, 95.0
"""Percentiles of a 90 % interval."""


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """Equal windows of the steps of a record.

    Args:
        edges: First step of every window and the end, shape (W + 1,).
        seed: Of the draws.
    """

    edges: Indices
    seed: int

    @classmethod
    def of(cls, count: int, seed: int = 0) -> "Windows":
        """Cut a number of steps."""
        return cls(np.linspace(0, count, min(WINDOWS, count) + 1).astype(np.intp), seed)

    def sums(self, values: Matrix | Vector) -> Matrix:
        """Sums over the rows of every window, shape (W, …)."""
        return np.add.reduceat(values, self.edges[:-1], axis=0)

    @property
    def lengths(self) -> Vector:
        """Steps of every window, shape (W,)."""
        return np.diff(self.edges).astype(float)

    def drawn(self, sums: Matrix) -> Matrix:
        """Sums of as many windows drawn anew, shape (DRAWS, …)."""
        rng = np.random.default_rng(self.seed)
        count = len(self.edges) - 1
        weight = np.stack(
            [np.bincount(row, minlength=count) for row in rng.integers(0, count, (DRAWS, count))]
        )
        return weight @ sums


def interval(draws: Vector) -> tuple[float, float]:
    """90 % interval of drawn values."""
    low, high = np.percentile(draws, (_LOW, _HIGH))
    return float(low), float(high)


def quiet_level(errors: Matrix, independent: float, windows: Windows) -> float:
    """Level of the quietest windows, of that of all of them [1]; 1 where all are alike.

    What begins late, comes and goes, or strikes here and there raises a floor that is one for the
    whole record; it does not raise that of the windows without it. The mean square of a window of
    L rows and n independent readings scatters by √(2/Ln); a window counts as quieter where it is
    further than three times that above the quietest one, which itself lies 1.6 times that below
    the mean of a dozen.

    Args:
        errors: Of predictions one row ahead, with the causes in the model, shape (T, n) [m].
        independent: How many independent readings those of a row are worth.
        windows: Of the record.
    """
    level = windows.sums(np.mean(errors**2, axis=1)) / windows.lengths
    scatter = np.sqrt(2.0 / (windows.lengths * independent))
    lowest = int(np.argmin(level))
    near = level < level[lowest] * (1.0 + 3.0 * scatter[lowest])
    quiet = float(np.average(level[near], weights=windows.lengths[near]))
    usual = float(np.average(level, weights=windows.lengths))
    return quiet / usual if quiet < usual * (1.0 - 3.0 * scatter[lowest]) else 1.0
