"""Intervals by a block bootstrap: neighbouring ticks are drawn together, as they depend."""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.physics.effect import generator
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

BLOCK = 25
"""Ticks of a block."""
DRAWS = 600
_ENDS = (0.05, 0.95)
_FEW = 4


@dataclass(frozen=True, slots=True, eq=False)
class Draws:
    """Records drawn from the blocks of one record, the same for everything that is compared.

    Args:
        weights: How often every draw has every block, shape (DRAWS, B); the first row is the
            record itself.
        edges: First row of every block, and the number of rows, shape (B + 1,).
        counted: Rows that count, shape (N,).
    """

    weights: Matrix
    edges: Indices
    counted: Mask

    @classmethod
    def of(cls, counted: Mask, seed: int, block: int = BLOCK) -> "Draws":
        """Draw.

        Args:
            counted: Rows that count, shape (N,).
            seed: Of the draws.
            block: Ticks of a block.
        """
        blocks = min(max(_FEW, len(counted) // block), len(counted))
        edges = np.linspace(0, len(counted), blocks + 1).astype(np.intp)
        rng = generator(seed, "diagnose blocks")
        drawn = rng.multinomial(blocks, np.full(blocks, 1.0 / blocks), size=DRAWS)
        drawn = drawn.astype(np.float64)
        return cls(np.vstack([np.ones(blocks), drawn]), edges, counted)

    def sums(self, by_row: Matrix) -> Matrix:
        """Sum what every draw has, shape (DRAWS + 1, …) of by_row (N, …)."""
        kept = np.where(self.counted.reshape(-1, *[1] * (by_row.ndim - 1)), by_row, 0.0)
        in_blocks = np.add.reduceat(kept, self.edges[:-1], axis=0)
        return np.tensordot(self.weights, in_blocks, axes=1)

    def means(self, by_row: Matrix) -> Matrix:
        """Mean over the ticks of every draw, shape (DRAWS + 1, …)."""
        total = self.sums(by_row)
        ticks = self.sums(np.ones(len(self.counted)))
        return total / np.maximum(ticks, 1.0).reshape(-1, *[1] * (by_row.ndim - 1))


@dataclass(frozen=True, slots=True)
class Interval:
    """A number with its 90 % interval.

    Args:
        value: Of the record itself.
        low: 5 % of the draws are below.
        high: 5 % of the draws are above.
        resolved: Whether nearly all draws are above zero.
    """

    value: float
    low: float
    high: float
    resolved: bool


def interval(draws: Vector, share: float = 0.995) -> Interval:
    """Read an interval off draws, the first of which is the record itself.

    Args:
        draws: Shape (DRAWS + 1,).
        share: Of the draws that have to be above zero for the number to be resolved.
    """
    low, high = np.quantile(draws[1:], _ENDS)
    value = float(draws[0])
    above = bool(np.quantile(draws[1:], 1.0 - share) > 0.0) and value > 0.0
    return Interval(value, min(float(low), value), max(float(high), value), above)
