"""Hours on an accelerated clock: the loop with all that listens to it, on a ring in process.

The clock is injected, so that a tick of 0.1 s takes as long as its arithmetic. Now and then a BPM
fails, the beam is kicked, the beam is lost and an operator closes again: what lives only for a
fault is made and forgotten thousands of times.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil

from orbitfb.core.clock import ManualClock
from orbitfb.core.signals import LoopState, Reading
from orbitfb.history.archive import ArchiveSettings, ArchiveWriter
from orbitfb.history.buffer import History
from orbitfb.loop.guard import Safeguards
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.observe.statistics.running import LoopStatistics
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant
from orbitfb.physics.plant_machine import PlantMachine
from orbitfb.policies.masking import without
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings
from tests.soak.flat import Soak, first_and_last

RATE = 10.0
DISK_GB = 0.2
EVERY = 20
"""Ticks between two samples of the process."""


class Unreliable(PlantMachine):
    """A ring some of whose BPMs fail at random for a while, without end."""

    def __init__(self, plant: Plant, clock: ManualClock, seed: int) -> None:
        super().__init__(plant, clock, 1.0 / RATE)
        self._rng = np.random.default_rng(seed)
        self._bad = np.zeros(len(plant.channels.bpms), dtype=bool)

    def read(self, timeout: float) -> Reading:
        """Read with what is broken now."""
        rng, tick = self._rng, self.plant.tick
        if tick % 100 == 99:
            self._bad[:] = False
            self._bad[rng.permutation(60)[: rng.integers(0, 5)] * 3] = True
        if tick % 1000 == 999:
            self.plant.kick(20e-6)
        self.current = 0.001 if tick % 18000 == 17999 else 0.4  # lost twice an hour
        reading = super().read(timeout)
        orbit = reading.orbit
        return replace(reading, orbit=replace(orbit, valid=orbit.valid & ~self._bad))


def simulate(
    hours: float, directory: Path, seed: int = 1, say: Callable[[str], None] = lambda _: None
) -> Soak:
    """Run so many hours of the ring.

    Args:
        hours: Simulated time [h].
        directory: For the archive.
        seed: Of ring and faults.
        say: Gets a line now and then.
    """
    ring, clock = Ring.load(), ManualClock()
    machine = Unreliable(Plant(ring, "x", seed=seed), clock, seed)
    channels, response = machine.channels, machine.plant.nominal_response
    archive = ArchiveWriter(
        directory, channels, ArchiveSettings(segment_megabytes=20.0, keep_gigabytes=DISK_GB)
    )
    statistics = LoopStatistics(channels, LimitSettings().setpoint, clock)
    policy = SvdPolicy(response, SvdSettings())
    runner = Runner(
        machine,
        PolicySlot(policy),
        LoopSettings(rate_hz=RATE),
        LimitSettings(),
        InterlockSettings(),
        np.zeros(len(channels.bpms)),
        clock,
        start=LoopState.CLOSED,
        subscribers=(History(channels, 2000), archive, statistics),
        safeguards=Safeguards(SvdPolicy(response, SvdSettings(), "baseline"), without),
        random=np.random.default_rng([seed, 1]),
    )
    ticks = round(hours * 3600 * RATE)
    spent = np.zeros(ticks)
    samples, trips = [], 0
    process, began = psutil.Process(), time.monotonic()
    try:
        for tick in range(ticks):
            start = time.perf_counter()
            runner.step()
            spent[tick] = time.perf_counter() - start
            if runner.state is LoopState.TRIPPED:
                trips += 1
                runner.command("reset")
            elif runner.state is LoopState.OPEN:
                runner.command("close")
            if tick % EVERY == 0:
                samples.append(_sample(process))
                statistics.snapshot()
            if tick % 36000 == 35999:
                say(f"{(tick + 1) / 36000:.0f} h simulated in {time.monotonic() - began:.0f} s")
            if archive.status().waiting > 200:
                time.sleep(0.01)  # the disk has as much time as on a ring, nearly
    finally:
        archive.close()
    rows = np.array(samples)[len(samples) // 10 :]
    part = max(1, len(rows) // 6)
    latency = spent[ticks // 10 :] * 1e3
    window = min(6000, len(latency) // 3)  # 10 minutes of the ring
    memory, files, threads = (first_and_last(column, part, np.median) for column in rows.T)
    return Soak(
        "simulated",
        ticks,
        hours,
        round(time.monotonic() - began, 1),
        memory,
        files,
        threads,
        first_and_last(latency, window, lambda part: np.percentile(part, 99)),
        first_and_last(latency, window, np.median),
        archive.status().dropped,
        f"{trips} trips, {archive.status().dropped} ticks not archived",
    )


def _sample(process: psutil.Process) -> tuple[float, int, int]:
    return process.memory_info().rss / 2**20, process.num_fds(), process.num_threads()
