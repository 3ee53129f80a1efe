"""The loop of orbitfb as a client process, with or without the rest of the service."""

import gc
import json
import os
import sys
import tempfile
import threading
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from benchmarks.clients import ClientJob
from benchmarks.disturbance import disturbed
from benchmarks.recorder import Recorder
from benchmarks.rings import build_ring
from orbitfb.core.clock import SystemClock
from orbitfb.core.ports import Subscriber
from orbitfb.core.signals import LoopState
from orbitfb.epics.machine import EpicsMachine
from orbitfb.epics.settings import (
    PVA_SEARCH_PORT,
    AuxiliarySettings,
    EpicsSettings,
    PvaSettings,
)
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings
from orbitfb.sim.layout import TICK_PV

LOCKSTEP_LOOP = LoopSettings(rate_hz=2000.0, hold_after=1000.0)
"""Takes every orbit that comes up to 4 kHz, and waits longer than a ring in lockstep does."""


class Diagonal:
    """A law for counting rings: its cost grows with the number of BPMs, not with its square."""

    policy_id = "diagonal"

    def initial_state(self) -> None:
        return None

    def act(self, error: np.ndarray, valid: np.ndarray, state: None) -> tuple[np.ndarray, None]:
        return np.where(valid, -0.1 * error, 0.0), state


def main() -> None:
    job = ClientJob.load(sys.stdin.read())
    run, clock = job.run, SystemClock()
    ring, _ = build_ring(job.sim, run.size)
    channels = ring.channels
    settings = EpicsSettings(server_port=job.port, connect_timeout=60.0)
    settings = settings.model_copy(
        update={
            "pva": PvaSettings(port=job.pva_port or PVA_SEARCH_PORT),
            "auxiliary": {
                **settings.auxiliary,
                "tick": AuxiliarySettings(pv=TICK_PV),
                "applied": AuxiliarySettings(pv=channels.setpoint_pvs[-1]),
            },
        }
    )
    stop = threading.Event()
    with ExitStack() as stack:
        machine = stack.enter_context(EpicsMachine(channels, settings, clock))
        recorder = Recorder(job, machine, clock, stop)
        svd = SvdPolicy(response(Ring.load(), job.sim.planes), SvdSettings())
        slot = PolicySlot(svd if run.size is None else Diagonal())
        subscribers: tuple[Subscriber, ...] = ()
        if run.client == "service":
            from benchmarks.surroundings import Surroundings  # much that the loop needs not

            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            surroundings = Surroundings(channels, svd.response, slot, folder, clock, stack)
            subscribers = surroundings.subscribers
        runner = Runner(
            machine,
            slot,
            LoopSettings(rate_hz=run.rate_hz) if run.rate_hz else LOCKSTEP_LOOP,
            LimitSettings(),
            InterlockSettings(),
            np.zeros(len(channels.bpms)),
            clock,
            start=LoopState.CLOSED,
            subscribers=(*subscribers, recorder),
        )
        stack.enter_context(disturbed(run.disturb, slot, job.sim))
        gc.collect()
        gc.freeze()
        runner.run(stop)
        figures = recorder.figures(runner)
        print(json.dumps(figures), flush=True)
        os._exit(0)


if __name__ == "__main__":
    main()
