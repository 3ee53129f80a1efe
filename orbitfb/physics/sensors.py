"""What the BPMs make of the orbit."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.physics.effect import Effect


class BpmNoise(Effect):
    """White noise, independent between BPMs and between ticks.

    Args:
        rms: Of every reading [m].
        rng: Random numbers of this effect.
    """

    def __init__(self, rms: float, rng: np.random.Generator) -> None:
        self._rms, self._rng = rms, rng

    def sense(self, orbit: Vector, tick: int) -> Vector:
        """Add the noise."""
        return orbit + self._rms * self._rng.standard_normal(orbit.shape)
