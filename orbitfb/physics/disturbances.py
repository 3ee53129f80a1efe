"""What moves the orbit besides the correctors: quadrupoles that stand, creep or jump aside."""

import math

import numpy as np

from orbitfb.core.errors import RingError
from orbitfb.core.signals import Vector
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Planes, Ring, split
from orbitfb.physics.response import quadrupole_displacement_response


class QuadrupoleOrbits:
    """Random orbits of the shapes that displaced quadrupoles can make, plane by plane.

    Args:
        ring: The ring.
        planes: `x`, `y` or `xy`.

    Raises:
        RingError: The ring has no quadrupoles.
    """

    def __init__(self, ring: Ring, planes: Planes) -> None:
        # Per plane, scaled so that normal numbers of unit variance give an expected rms of 1.
        self._unit: list[Matrix] = []
        for plane in split(planes):
            response = quadrupole_displacement_response(ring, plane)
            size = float(np.linalg.norm(response))
            if size == 0:
                raise RingError(
                    "the places table has no quadrupole with a strength, so none can move the "
                    "orbit; add the quadrupoles"
                )
            self._unit.append(response * (math.sqrt(len(response)) / size))

    def covariance(self) -> list[Matrix]:
        """Give the covariance of the orbits of every plane, whose expected rms is 1."""
        return [unit @ unit.T for unit in self._unit]

    def draw(self, rng: np.random.Generator) -> Vector:
        """Draw an orbit of an *expected* rms of 1 in every plane, shape (n,)."""
        return np.concatenate(self._by_plane(rng))

    def draw_exactly(self, rng: np.random.Generator, rms: float) -> Vector:
        """Draw an orbit whose rms is the given one [m] in every plane, shape (n,) [m]."""
        orbits = self._by_plane(rng)
        return np.concatenate([orbit * (rms / np.sqrt(np.mean(orbit**2))) for orbit in orbits])

    def _by_plane(self, rng: np.random.Generator) -> list[Vector]:
        return [unit @ rng.standard_normal(unit.shape[1]) for unit in self._unit]


class InitialOrbit(Effect):
    """The orbit of quadrupoles that were never aligned to better than that.

    Args:
        orbits: Shapes of orbits.
        rms: At the BPMs, in every plane [m].
        rng: Random numbers of this effect.
    """

    def __init__(self, orbits: QuadrupoleOrbits, rms: float, rng: np.random.Generator) -> None:
        self._orbit = orbits.draw_exactly(rng, rms)

    def disturb(self, orbit: Vector, tick: int) -> Vector:
        """Add the standing orbit."""
        return orbit + self._orbit


class GroundMotion(Effect):
    """Quadrupoles that wander: a random walk that forgets, AR(1), from rest at tick 0.

    Args:
        orbits: Shapes of orbits.
        rms: Of the change per tick at the BPMs, in every plane [m].
        memory: Ticks after which 1/e of a displacement is left.
        rng: Random numbers of this effect.
    """

    def __init__(
        self, orbits: QuadrupoleOrbits, rms: float, memory: float, rng: np.random.Generator
    ) -> None:
        self._orbits, self._rms, self._rng = orbits, rms, rng
        self._keep = math.exp(-1.0 / memory)
        self._orbit: Vector | None = None

    def disturb(self, orbit: Vector, tick: int) -> Vector:
        """Let the quadrupoles move on and add their orbit."""
        # The orbit is linear in the displacements, so it obeys their recursion.
        if self._orbit is None:
            self._orbit = np.zeros_like(orbit)
        else:
            self._orbit = self._keep * self._orbit + self._rms * self._orbits.draw(self._rng)
        return orbit + self._orbit


class Kicks(Effect):
    """Sudden steps of the orbit, on request; each of them stays.

    Args:
        orbits: Shapes of orbits.
        rng: Random numbers of this effect.
    """

    def __init__(self, orbits: QuadrupoleOrbits, rng: np.random.Generator) -> None:
        self._orbits, self._rng = orbits, rng
        self._orbit: Vector | None = None

    def kick(self, rms: float) -> None:
        """Step the orbit by a random shape of the given rms [m] in every plane."""
        step = self._orbits.draw_exactly(self._rng, rms)
        self._orbit = step if self._orbit is None else self._orbit + step

    def disturb(self, orbit: Vector, tick: int) -> Vector:
        """Add the steps so far."""
        return orbit if self._orbit is None else orbit + self._orbit
