"""How effects on readings and on their noise join the plant."""

from collections.abc import Callable

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.physics.effect import Effect
from orbitfb.physics.places import Indices

Change = Callable[[Vector], Vector]
"""Called once per tick with the columns of the effect, shape (k,) in and out; must not change
what it is given."""


class ChangedReadings(Effect):
    """Readings of some BPMs that go through something on their way.

    Args:
        places: Columns of the orbit.
        change: What they go through.
    """

    def __init__(self, places: Indices, change: Change) -> None:
        self._places, self._change = places, change

    def sense(self, orbit: Vector, tick: int) -> Vector:
        """Change the columns."""
        readings = orbit.copy()
        readings[self._places] = self._change(orbit[self._places])
        return readings


class ChangedNoise(Effect):
    """Noise of the readings of some BPMs that goes through something; the orbit does not.

    What the readings have got so far beside the orbit is taken for their noise. So it must come
    after all effects that disturb the orbit, and before those that change readings.

    Args:
        places: Columns of the orbit.
        change: What the noise goes through.
    """

    def __init__(self, places: Indices, change: Change) -> None:
        self._places, self._change = places, change
        self._orbit: Vector = np.zeros(0)

    def disturb(self, orbit: Vector, tick: int) -> Vector:
        """Keep the true orbit."""
        self._orbit = orbit[self._places].copy()
        return orbit

    def sense(self, orbit: Vector, tick: int) -> Vector:
        """Change the noise of the columns."""
        readings = orbit.copy()
        noise = orbit[self._places] - self._orbit
        readings[self._places] += self._change(noise) - noise
        return readings
