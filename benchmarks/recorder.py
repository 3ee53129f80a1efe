"""A subscriber that keeps what a benchmark needs of every tick."""

import threading
import time
from collections import Counter
from typing import Any

import numpy as np

from benchmarks.clients import ClientJob
from benchmarks.measure import brief, cpu_time, window_figures
from benchmarks.rings import STEP
from orbitfb.core.ports import Clock
from orbitfb.core.signals import LoopState, Reading, TickRecord
from orbitfb.epics.machine import EpicsMachine
from orbitfb.loop.runner import Runner

_EQUAL = 1e-12
"""How well a reading must agree with the replay [m]."""
_FASTEST_HZ = 4000
_TIMES = ("stamp", "written", "applied", "check", "decide", "limit", "act", "latency", "shown")
_PHASES = ("check", "decide", "limit", "act")


class Recorder:
    """Keeps every tick from the end of the warm-up until the time is over, then stops the loop.

    It writes into arrays that are there beforehand: objects that pile up would make the garbage
    collector interrupt the loop that is measured.

    Args:
        job: What is measured.
        machine: Asked when the server applied the last setpoint.
        clock: Clock of the program.
        stop: Set at the end.
    """

    def __init__(
        self, job: ClientJob, machine: EpicsMachine, clock: Clock, stop: threading.Event
    ) -> None:
        self._job, self._machine, self._clock, self._stop = job, machine, clock, stop
        self._begin: float | None = None
        self._end: float | None = None
        room = int((job.run.seconds + 1.0) * (job.run.rate_hz or _FASTEST_HZ)) + 10
        self._times = np.full(room, np.nan, dtype=[(name, np.float64) for name in _TIMES])
        replayed = room if job.run.size is None else 0
        channels = machine.channels
        self._positions = np.zeros((replayed, len(channels.bpms)))
        self._readbacks = np.zeros((replayed, len(channels.correctors)))
        self._offsets = np.arange(len(channels.bpms)) * STEP
        self._count = self._torn = self._missed = 0
        self._states: Counter[str] = Counter()
        self._reasons: Counter[str] = Counter()
        self._policies: set[str] = set()
        self._cpu = (0.0, 0.0)

    def __call__(self, record: TickRecord) -> None:
        now = time.monotonic()
        if self._begin is None:
            if record.state is LoopState.CLOSED:
                self._begin = now + self._job.run.warmup
        elif self._end is None:
            if now >= self._begin:
                self._end = now + self._job.run.seconds
                self._cpu = self._used()
        elif not self._stop.is_set():
            self._keep(record)
            if now >= self._end or self._count == len(self._times):
                used = self._used()
                self._cpu = (used[0] - self._cpu[0], used[1] - self._cpu[1])
                self._stop.set()

    def _keep(self, record: TickRecord) -> None:
        self._states[str(record.state)] += 1
        self._missed += record.missed
        self._policies.add(record.policy_id)
        if record.reason:
            self._reasons[record.reason] += 1
        if (reading := record.reading) is None:
            return
        applied = self._clock.wall() - self._machine.auxiliary_ages()["applied"]
        phases = record.phases
        self._times[self._count] = (
            reading.orbit.time,
            record.written,
            applied,
            phases.check,
            phases.decide,
            phases.limit,
            phases.act,
            record.latency,
            reading.auxiliary["tick"],
        )
        self._keep_vectors(reading)
        self._count += 1

    def _keep_vectors(self, reading: Reading) -> None:
        if self._job.run.size is None:
            self._positions[self._count] = reading.orbit.position
            self._readbacks[self._count] = reading.readback
        else:
            common = reading.orbit.position - self._offsets
            self._torn += not np.ptp(common) < _EQUAL

    def _used(self) -> tuple[float, float]:
        return cpu_time(self._job.server_pid), time.process_time()

    def figures(self, runner: Runner) -> dict[str, Any]:
        """Sum up."""
        if self._count < 2:
            raise SystemExit(f"{self._count} orbits were read: {runner.reason}")
        times = self._times[: self._count]
        figures = window_figures(
            period=self._job.period,
            stamps=times["stamp"],
            put_from=times["written"] - times["act"],
            put_until=times["written"],
            applied=times["applied"],
            torn=self._differing() if self._job.run.size is None else self._torn,
            server_cpu=self._cpu[0],
            client_cpu=self._cpu[1],
        )
        return figures | {
            "counted_as_missed_by_the_loop": self._missed,
            "states": self._states,
            "reasons": dict(self._reasons.most_common(5)),
            "policies": len(self._policies),
            "phases_ms": {name: brief(times[name]) for name in _PHASES},
            "loop_latency_ms": brief(times["latency"]),
        }

    def _differing(self) -> int:
        """Run the same ring again under the setpoints that were read back, and compare.

        The ring's random numbers come from its seed and do not depend on the setpoints, so the
        orbit of every tick is known to the last digit: a reading of two ticks, or one under
        another set of setpoints than its readbacks say, differs.
        """
        plant, _ = self._job.sim.build()
        nothing = np.zeros(self._readbacks.shape[1])
        alone: dict[int, np.ndarray] = {}  # orbits without correctors
        differing = 0
        for row in range(self._count):
            shown = round(self._times["shown"][row])
            while plant.tick <= shown:
                reading = plant.step(nothing).reading
                alone[plant.tick] = reading
            corrected = plant.response @ self._readbacks[row]
            # the count is read apart from the orbit: it may be that of the tick before or after
            differing += not any(
                tick in alone
                and np.abs(alone[tick] + corrected - self._positions[row]).max() < _EQUAL
                for tick in (shown - 1, shown, shown + 1)
            )
            for tick in [tick for tick in alone if tick < shown - 1]:
                del alone[tick]
        return differing
