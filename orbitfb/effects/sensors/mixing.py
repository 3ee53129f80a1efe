"""How effects that tie two readings join the plant."""

from orbitfb.core.signals import Vector
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices


class MixedReadings(Effect):
    """Pairs of readings that go through a 2 × 2 matrix.

    Args:
        pairs: Columns, no column twice, shape (P, 2).
        matrix: Shape (2, 2).
    """

    def __init__(self, pairs: Indices, matrix: Matrix) -> None:
        self._pairs, self._matrix = pairs, matrix

    def sense(self, orbit: Vector, tick: int) -> Vector:
        """Mix."""
        readings = orbit.copy()
        readings[self._pairs] = orbit[self._pairs] @ self._matrix.T
        return readings
