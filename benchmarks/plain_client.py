"""The loop as a physicist would write it: PV.callback, one matrix product, PV.put.

pyepics monitors every PV unless told not to; the `lean` form tells it so for the correctors (but
for the last one, by whose time stamp the benchmark knows when the server applied it).
"""

import json
import os
import sys
import threading
import time
from typing import Any

import epics
import numpy as np

from benchmarks.clients import ClientJob
from benchmarks.measure import cpu_time, window_figures
from benchmarks.rings import build_ring
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response

GAIN = 0.5
REGULARISATION = 50e-6  # [m/A]
MILLIMETRE = 1e-3


def main() -> None:
    job = ClientJob.load(sys.stdin.read())
    ring, _ = build_ring(job.sim, job.run.size)
    channels = ring.channels
    size = len(channels.bpms)
    law = GAIN * MILLIMETRE * _inverse(job, size)
    index = {name: i for i, name in enumerate(channels.orbit_pvs)}
    last = size - 1
    orbit, times = np.zeros(size), np.zeros(size)
    ready = threading.Event()
    applied: list[float] = []

    def on_orbit(pvname: str, value: float, timestamp: float, **_: Any) -> None:
        i = index[pvname]
        orbit[i] = value
        times[i] = timestamp
        if i == last:
            ready.set()

    def on_applied(timestamp: float, **_: Any) -> None:
        applied.append(timestamp)

    monitor = False if job.run.client == "lean" else None
    correctors = [epics.PV(name, auto_monitor=monitor) for name in channels.setpoint_pvs[:-1]]
    correctors.append(epics.PV(channels.setpoint_pvs[-1], callback=on_applied, auto_monitor=True))
    for corrector in correctors:
        corrector.wait_for_connection(30.0)
    bpms = [epics.PV(name, callback=on_orbit, auto_monitor=True) for name in index]
    for bpm in bpms:
        bpm.wait_for_connection(30.0)
    epics.poll(0.1, 1.0)  # a subscription made on libca's thread is not sent before a flush

    setpoints = np.zeros(len(correctors))
    rows: list[tuple[float, float, float, bool]] = []
    begin = end = None
    cpu = np.zeros(2)
    while end is None or time.monotonic() < end:
        if not ready.wait(10.0):
            sys.exit("no orbit for 10 s")
        ready.clear()
        stamp, torn = float(times[last]), bool(np.ptp(times))
        setpoints -= law @ orbit
        put_from = time.time()
        for corrector, setpoint in zip(correctors, setpoints, strict=True):
            corrector.put(setpoint, wait=False)
        row = (stamp, put_from, time.time(), torn)
        now = time.monotonic()
        begin = begin or now + job.run.warmup
        if end is None and now >= begin:
            end = now + job.run.seconds
            cpu = _cpu(job)
        elif end is not None:
            rows.append(row)
    spent = _cpu(job) - cpu
    time.sleep(0.2)  # the last put may not have been applied yet
    stamps, put_from_all, put_until, torn_all = (
        np.array(column) for column in zip(*rows, strict=True)
    )
    figures = window_figures(
        period=job.period,
        stamps=stamps,
        put_from=put_from_all,
        put_until=put_until,
        applied=np.array(applied),
        torn=int(torn_all.sum()),
        server_cpu=spent[0],
        client_cpu=spent[1],
    )
    print(json.dumps(figures), flush=True)
    os._exit(0)


def _inverse(job: ClientJob, size: int) -> np.ndarray:
    """Regularised inverse, (m, n) [A/m]; of a counting ring: something of the same cost."""
    if job.run.size is not None:
        return np.eye(size) * 1e-3
    u, s, vt = np.linalg.svd(response(Ring.load(), job.sim.planes))
    return (vt.T * (s / (s**2 + REGULARISATION**2))) @ u.T


def _cpu(job: ClientJob) -> np.ndarray:
    return np.array([cpu_time(job.server_pid), time.process_time()])


if __name__ == "__main__":
    main()
