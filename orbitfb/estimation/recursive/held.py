"""What the correctors hold, of which a drift of R makes the creep.

A drift of R under currents h moves the orbit by Ṙ h a tick. The creep c of a mode is told for
currents of a norm h₀, those that were held when the estimate began, whatever they are. With h of
them added since, the orbit creeps by c |h'| / h₀, h' = (h, h₀). Where h' turns, from one direction
to another at an angle of cosine ρ, so much of the creep stays known: Ṙ is as much along one as
along another, so

    c ← ρ c + √(1 − ρ²) c₀,

c₀ a creep of which only the prior is known.
"""

import math

import numpy as np

from orbitfb.core.signals import Vector


class HeldCurrents:
    """The currents h', since the estimate began and before.

    Args:
        size: m, count of the correctors.
        norm: h₀ [A, or rad where changes are kicks]; None: the creep is the same whatever is held.

    Attributes:
        load: |h'| / h₀ [1].
    """

    def __init__(self, size: int, norm: float | None) -> None:
        self._norm = np.inf if norm is None else norm
        self._added = np.zeros(size)
        self._last, self._last_load = self._added, 1.0
        self.load = 1.0

    def add(self, change: Vector) -> None:
        """Add a change, shape (m,)."""
        self._added = self._added + change
        self.load = math.sqrt(1.0 + self._along(self._added))

    def turned(self) -> float:
        """Give ρ since it was last asked, or since the beginning [1]."""
        cosine = (1.0 + self._along(self._last)) / (self.load * self._last_load)
        self._last, self._last_load = self._added, self.load
        return min(cosine, 1.0)

    def _along(self, other: Vector) -> float:
        return float(self._added.dot(other)) / self._norm**2
