"""The simulated ring: absolute setpoints in, one orbit per tick out.

Setpoints [A] → actuators → magnet currents → closed orbit + disturbances → sensors → readings,
as a pipeline that effects join (`orbitfb.physics.effect`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from orbitfb.core.errors import WriteError
from orbitfb.core.settings import Settings
from orbitfb.core.signals import Channels, Vector
from orbitfb.physics.disturbances import GroundMotion, InitialOrbit, Kicks, QuadrupoleOrbits
from orbitfb.physics.drift import Drift, DriftSettings
from orbitfb.physics.effect import Effect, generator
from orbitfb.physics.frequency import frequency_response
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Planes, Ring
from orbitfb.physics.response import response
from orbitfb.physics.sensors import BpmNoise


class PlantSettings(Settings):
    """What the simulated ring suffers from."""

    bpm_noise_rms: float = Field(
        default=0.2e-6, ge=0, description="White noise of every BPM reading, rms [m]."
    )
    ground_motion_rms: float = Field(
        default=0.04e-6,
        ge=0,
        description="Change of the orbit per tick at the BPMs by moving quadrupoles, rms [m].",
    )
    ground_motion_memory: float = Field(
        default=10_000,
        ge=1,
        description="Time in which a displaced quadrupole comes back to 1/e [ticks].",
    )
    initial_orbit_rms: float = Field(
        default=250e-6,
        ge=0,
        description="Orbit at the start at the BPMs, from misaligned quadrupoles, rms [m].",
    )
    drift: DriftSettings = Field(
        default=DriftSettings(), description="Drift of the response from R1 to R2."
    )


@dataclass(frozen=True, slots=True, eq=False)
class PlantState:
    """What one tick of the plant gives.

    Args:
        reading: What the BPMs tell, shape (n,) [m].
        true_orbit: Where the beam is, shape (n,) [m].
        readback: Currents of the correctors, shape (m,) [A].
    """

    reading: Vector
    true_orbit: Vector
    readback: Vector


class Plant:
    """A ring that answers setpoints with orbits, reproducible from its seed.

    Args:
        ring: The ring.
        planes: `x`, `y` or `xy`.
        settings: What it suffers from.
        seed: Of every random number; each effect has its own stream.
        effects: More effects; they come after the plant's own in every stage. Give each its
            random numbers by `orbitfb.physics.effect.generator`.
    """

    def __init__(
        self,
        ring: Ring,
        planes: Planes = "x",
        settings: PlantSettings | None = None,
        seed: int = 0,
        effects: Sequence[Effect] = (),
    ) -> None:
        self.ring = ring
        self.settings = settings or PlantSettings()
        self.channels: Channels = ring.channels(planes)
        self._tick = 0
        self._nominal = response(ring, planes)
        self._per_hertz = frequency_response(ring, planes)
        self._kicks, own = _own_effects(ring, planes, self.settings, seed)
        self.effects: tuple[Effect, ...] = (*own, *effects)

    @property
    def tick(self) -> int:
        """Count of orbits so far; the number of the next one."""
        return self._tick

    @property
    def nominal_response(self) -> Matrix:
        """What the optics of the table say, shape (n, m) [m/A]; a copy."""
        return self._nominal.copy()

    @property
    def response(self) -> Matrix:
        """The true R_t that the next step will use, shape (n, m) [m/A]."""
        return self.response_at(self._tick)

    def response_at(self, tick: int) -> Matrix:
        """Tell the true R_t of any tick, shape (n, m) [m/A]."""
        currents = np.eye(self._nominal.shape[1])
        orbit = self._nominal
        for effect in self.effects:
            orbit = effect.respond(orbit, currents, tick)
        return orbit.copy()

    def step(self, setpoints: Vector, frequency_change: float = 0.0) -> PlantState:
        """Let one tick pass.

        Args:
            setpoints: Absolute, in force during this tick, shape (m,) [A].
            frequency_change: RF frequency beyond the nominal one during this tick [Hz]; it moves
                the beam along the dispersion, in plane x.

        Returns:
            The orbit of this tick.

        Raises:
            WriteError: The setpoints have a wrong shape or are not finite; no time has passed.
        """
        correctors = self._nominal.shape[1]
        if setpoints.shape != (correctors,) or not np.isfinite(setpoints).all():
            raise WriteError(
                f"setpoints of shape {setpoints.shape} with "
                f"{np.count_nonzero(~np.isfinite(setpoints))} values that are not finite; give "
                f"{correctors} finite currents [A], x first and then y"
            )
        tick, currents = self._tick, setpoints.copy()
        for effect in self.effects:
            currents = effect.actuate(currents, tick)
        orbit = self._nominal @ currents
        for effect in self.effects:
            orbit = effect.respond(orbit, currents, tick)
        if frequency_change:
            orbit = orbit + self._per_hertz * frequency_change
        for effect in self.effects:
            orbit = effect.disturb(orbit, tick)
        reading = orbit
        for effect in self.effects:
            reading = effect.sense(reading, tick)
        self._tick += 1
        return PlantState(reading=reading, true_orbit=orbit, readback=currents)

    def kick(self, rms: float) -> None:
        """Step the orbit from the next tick on, by quadrupoles that jump aside.

        Args:
            rms: Of the step at the BPMs, in every plane [m].
        """
        self._kicks.kick(rms)


def _own_effects(
    ring: Ring, planes: Planes, settings: PlantSettings, seed: int
) -> tuple[Kicks, tuple[Effect, ...]]:
    orbits = QuadrupoleOrbits(ring, planes)
    kicks = Kicks(orbits, generator(seed, "kicks"))
    effects: list[Effect] = [kicks]
    if settings.drift.ticks > 0:
        effects.append(Drift(ring, planes, settings.drift, generator(seed, "drift")))
    if settings.initial_orbit_rms > 0:
        rng = generator(seed, "initial orbit")
        effects.append(InitialOrbit(orbits, settings.initial_orbit_rms, rng))
    if settings.ground_motion_rms > 0:
        rng = generator(seed, "ground motion")
        memory = settings.ground_motion_memory
        effects.append(GroundMotion(orbits, settings.ground_motion_rms, memory, rng))
    if settings.bpm_noise_rms > 0:
        effects.append(BpmNoise(settings.bpm_noise_rms, generator(seed, "BPM noise")))
    return kicks, tuple(effects)
