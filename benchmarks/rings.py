"""The rings behind the servers: the simulated one, or one of any size that costs nothing."""

import numpy as np

from orbitfb.core.signals import Channels, Vector
from orbitfb.physics.plant import PlantState
from orbitfb.sim.job import SimJob
from orbitfb.sim.ring import SimulatedRing
from orbitfb.sim.settings import SimSettings

STEP = 1e-9
"""How far the readings of neighbouring BPMs of a counting ring lie apart [m]."""
_PATTERN = 1e-7 * (np.arange(10) * 7 % 10 - 4.5)
"""Common part of the readings of ten ticks [m]: it never grows three times in a row."""


class CountingRing:
    """A ring without physics: its readings count the ticks, so that a torn orbit shows.

    BPM i reads the same as all others plus `i * STEP`, and every tick another value; readbacks are
    the setpoints. A step costs two passes over a vector, so that what is measured on it is Channel
    Access.

    Args:
        size: Count of BPMs, and of correctors.
    """

    def __init__(self, size: int) -> None:
        self.channels = counting_channels(size)
        self.tick = 0
        self._offsets = np.arange(size) * STEP

    def step(self, setpoints: Vector, frequency_change: float = 0.0) -> PlantState:
        reading = self._offsets + _PATTERN[self.tick % len(_PATTERN)]
        self.tick += 1
        return PlantState(reading, reading, setpoints.copy())

    def kick(self, rms: float) -> None:
        raise NotImplementedError("a counting ring has no beam to kick")


def counting_channels(size: int) -> Channels:
    numbers = range(1, size + 1)
    return Channels(
        planes="x",
        bpms=tuple(f"P{i}" for i in numbers),
        correctors=tuple(f"C{i}" for i in numbers),
        orbit_pvs=tuple(f"SR:C00-BI{{BPM:{i}}}Pos:X-I" for i in numbers),
        setpoint_pvs=tuple(f"SR:C00-MG{{PS:CH{i}}}I:Sp1-SP" for i in numbers),
        readback_pvs=tuple(f"SR:C00-MG{{PS:CH{i}}}I:Ps1DCCT1-I" for i in numbers),
    )


def build_ring(job: SimJob, size: int | None) -> tuple[SimulatedRing, SimSettings]:
    """Make the ring of the job, or a counting one if a size is given."""
    return job.build() if size is None else (CountingRing(size), job.sim)
