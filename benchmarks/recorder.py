"""A subscriber that keeps what a benchmark needs of every tick."""

import threading
import time
from collections import Counter
from typing import Any

import numpy as np

from benchmarks.clients import ClientJob
from benchmarks.measure import cpu_time, spread, window_figures
from benchmarks.rings import STEP
from orbitfb.core.ports import Clock
from orbitfb.core.signals import LoopState, TickRecord
from orbitfb.epics.machine import EpicsMachine
from orbitfb.loop.runner import Runner

_EQUAL = 1e-12
"""How well a reading must agree with the replay [m]."""


class Recorder:
    """Keeps every record from the end of the warm-up until the time is over, then stops the loop.

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
        self._records: list[TickRecord] = []
        self._applied: list[float] = []
        self._cpu = (0.0, 0.0)

    def __call__(self, record: TickRecord) -> None:
        now = time.monotonic()
        if self._begin is None:
            if record.state is LoopState.CLOSED:
                self._begin = now + self._job.run.warmup
            return
        if self._end is None:
            if now >= self._begin:
                self._end = now + self._job.run.seconds
                self._cpu = self._used()
            return
        self._records.append(record)
        self._applied.append(self._clock.wall() - self._machine.auxiliary_ages()["applied"])
        if now >= self._end and not self._stop.is_set():
            used = self._used()
            self._cpu = (used[0] - self._cpu[0], used[1] - self._cpu[1])
            self._stop.set()

    def _used(self) -> tuple[float, float]:
        return cpu_time(self._job.server_pid), time.process_time()

    def figures(self, runner: Runner) -> dict[str, Any]:
        """Sum up."""
        records = self._records
        seen = [record for record in records if record.reading is not None]
        if not seen:
            raise SystemExit(f"no orbit was read: {runner.reason}")
        until = np.array([record.written for record in seen])
        acting = np.array([record.phases.act for record in seen])
        figures = window_figures(
            period=self._job.period,
            stamps=np.array([r.reading.orbit.time for r in seen if r.reading]),
            put_from=until - acting,
            put_until=until,
            applied=np.array(self._applied),
            torn=self._torn(seen),
            server_cpu=self._cpu[0],
            client_cpu=self._cpu[1],
        )
        return figures | {
            "counted_as_missed_by_the_loop": sum(record.missed for record in records),
            "states": Counter(str(record.state) for record in records),
            "reasons": sorted({record.reason for record in records if record.reason})[:5],
            "swaps": len({r.policy_id for r in records}) - 1,
            "phases_ms": {
                name: spread([getattr(record.phases, name) for record in seen])
                for name in ("check", "decide", "limit", "act")
            },
            "loop_latency_ms": spread([record.latency for record in seen]),
        }

    def _torn(self, seen: list[TickRecord]) -> int:
        """Count the orbits that are not those of one tick of the ring."""
        positions = np.array([r.reading.orbit.position for r in seen if r.reading])
        if self._job.run.size is not None:
            ticks = positions - np.arange(positions.shape[1]) * STEP
            return int(np.count_nonzero(~(np.ptp(ticks, axis=1) < _EQUAL)))
        readbacks = np.array([r.reading.readback for r in seen if r.reading])
        shown = np.array([r.reading.auxiliary["tick"] for r in seen if r.reading])
        return self._differing(positions, readbacks, shown)

    def _differing(self, positions: np.ndarray, readbacks: np.ndarray, shown: np.ndarray) -> int:
        """Run the same ring again under the setpoints that were read back, and compare.

        The ring's random numbers come from its seed and do not depend on the setpoints, so the
        orbit of every tick is known to the last digit: a reading of another tick, or one under
        another set of setpoints than its readbacks say, differs.
        """
        plant, _ = self._job.sim.build()
        differing = 0
        for position, readback, tick in zip(positions, readbacks, shown.tolist(), strict=True):
            # the count comes last of all: it may still be that of the tick before
            for attempt in (tick, tick + 1):
                while plant.tick < attempt - 1:
                    plant.step(np.zeros_like(readback))
                if plant.tick != attempt - 1:
                    continue
                state = plant.step(np.nan_to_num(readback))
                if np.abs(state.reading - position).max() < _EQUAL:
                    break
            else:
                differing += 1
        return differing
