"""What moves the beam for days: tide, temperature, gaps of insertion devices, the ground.

Each of them is known here with its energy, so that the energy of the beam is known exactly.
"""

import math

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.physics.effect import Effect, generator
from orbitfb.physics.optics import energy_orbit, green
from orbitfb.physics.places import Ring

TIDE, TIDE_PERIOD = 3e-5, 12.42 * 3600.0
"""Amplitude of the relative energy deviation [1], and the principal lunar semidiurnal period [s].
At a momentum compaction of 3.6e-4 it is 1.1e-8 of the circumference, 8.6 µm of 792 m."""
DAY, DAY_ENERGY, DAY_KICK = 86400.0, 1e-5, 0.3e-6
"""A day [s]; what its temperature does to the energy by the circumference [1], and to the kick of
one quadrupole of every cell, amplitudes [rad]."""
DEVICES, GAP_KICK, GAP_DURATION, GAP_MOVES = 10, 1e-6, 60.0, 20.0
"""Insertion devices; kick of a closed one [rad]; duration of a move [s]; moves of each per day."""
GROUND, GROUND_MEMORY = 0.04e-6, 1000.0
"""As the plant's own: change of the orbit per 0.1 s, rms [m], and memory of a displacement [s]."""


class Surroundings(Effect):
    """Move the orbit, and know by how much the energy.

    Args:
        ring: The ring; plane x.
        period: Of a tick [s].
        seed: Of ground, gaps and signs.

    Attributes:
        energy: Relative energy deviation that they make now at a fixed frequency [1].
        moves: Moves of gaps so far.
    """

    def __init__(self, ring: Ring, period: float, seed: int) -> None:
        self.energy, self.moves = 0.0, 0
        self._period = period
        self._rng = rng = generator(seed, "surroundings")
        quadrupoles = ring.places("QUAD", "x")
        dispersion = ring.table.dispersion[quadrupoles]
        stretch = ring.parameters.alpha_c * ring.parameters.circumference
        self._per_kick = green(ring, "BPM", "QUAD", "x")
        self._energy_per_kick = -dispersion / stretch
        self._dispersion = energy_orbit(ring, "BPM", 1.0)

        strength = ring.strength("QUAD")
        orbits = self._per_kick * strength
        scale = math.sqrt(len(orbits)) / float(np.linalg.norm(orbits))
        self._ground_step = GROUND * math.sqrt(period / 0.1) * scale * strength
        self._keep = math.exp(-period / GROUND_MEMORY)
        self._ground = np.zeros(len(strength))

        cells = np.linspace(0, len(strength) - 1, 30).astype(int)
        self._warm = np.zeros(len(strength))
        self._warm[cells] = DAY_KICK * rng.choice([-1.0, 1.0], len(cells))
        self._devices = np.argsort(np.abs(dispersion))[:DEVICES]
        self._kicks = GAP_KICK * rng.choice([-1.0, 1.0], DEVICES)
        self._closed, self._wanted = np.zeros(DEVICES), np.zeros(DEVICES)

    def disturb(self, orbit: Vector, tick: int) -> Vector:
        """Add what all of them do."""
        now = tick * self._period
        day = math.sin(2 * math.pi * now / DAY)
        kicks = self._warm * day + self._of_ground()
        kicks[self._devices] += self._of_gaps()
        stretched = TIDE * math.sin(2 * math.pi * now / TIDE_PERIOD) + DAY_ENERGY * day
        self.energy = stretched + float(self._energy_per_kick @ kicks)
        return orbit + self._per_kick @ kicks + stretched * self._dispersion

    def _of_ground(self) -> Vector:
        step = self._ground_step * self._rng.standard_normal(len(self._ground))
        self._ground = self._keep * self._ground + step
        return self._ground.copy()

    def _of_gaps(self) -> Vector:
        moving = self._rng.random(DEVICES) < GAP_MOVES * self._period / DAY
        self.moves += int(np.count_nonzero(moving))
        self._wanted = np.where(moving, 1.0 - self._wanted, self._wanted)
        most = self._period / GAP_DURATION
        self._closed += np.clip(self._wanted - self._closed, -most, most)
        return self._kicks * self._closed
