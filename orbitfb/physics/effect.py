"""The seam of the plant: one small object per physical effect, four hooks, all optional."""

import zlib

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.physics.optics import Matrix


class Effect:
    """A physical effect on the way from setpoints to readings; this one does nothing.

    Every tick the plant runs the hooks of all its effects, stage by stage and in the order in
    which it holds them:

        currents = actuate(setpoints)            what the magnets carry, and what is read back
        orbit    = respond(R1 · currents)        what the magnets make of the orbit
        orbit   += disturb()                     what moves the orbit besides
        reading  = sense(orbit)                  what the BPMs tell

    An effect overrides the stages that it acts on. `actuate`, `disturb` and `sense` are called
    exactly once per tick, so they may carry state from tick to tick and draw random numbers;
    `respond` is also called to ask for the response, so it must depend on its arguments only.
    An effect must not change an array that it is given.
    """

    def actuate(self, setpoints: Vector, tick: int) -> Vector:
        """Turn setpoints into magnet currents, both of shape (m,) [A]."""
        return setpoints

    def respond(self, orbit: Matrix, currents: Matrix, tick: int) -> Matrix:
        """Change the orbit that the correctors make.

        Args:
            orbit: What the stages so far make of the currents, shape (n,) or (n, k) [m].
            currents: Shape (m,) [A], or k sets of them as columns (m, k).
            tick: Now.

        Returns:
            The orbit with this effect, shape as `orbit` [m].
        """
        return orbit

    def disturb(self, orbit: Vector, tick: int) -> Vector:
        """Add what moves the orbit besides the correctors: shape (n,) in and out [m]."""
        return orbit

    def sense(self, orbit: Vector, tick: int) -> Vector:
        """Turn positions into readings, both of shape (n,) [m]."""
        return orbit


def generator(seed: int, name: str) -> np.random.Generator:
    """Give an effect its own random numbers.

    They depend on the plant's seed and on the effect's name alone, so that adding, removing or
    reordering effects leaves the numbers of the others as they were.

    Args:
        seed: Seed of the plant.
        name: Name of the effect, unique within the plant.
    """
    return np.random.default_rng(
        np.random.SeedSequence(seed, spawn_key=(zlib.crc32(name.encode()),))
    )
