"""The ring in process, whose BPMs and power supplies lie on request."""

from dataclasses import replace

import numpy as np

from orbitfb.core.clock import ManualClock
from orbitfb.core.signals import LoopState
from orbitfb.loop.guard import Safeguards
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.physics.plant import Plant, PlantSettings
from orbitfb.physics.plant_machine import PlantMachine
from orbitfb.policies.masking import without
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings


class LyingMachine:
    """A machine whose `blind` BPMs read a pattern and noise, whose `deaf` supplies echo.

    Args:
        machine: The ring in process.
        seed: Of pattern and noise.
    """

    def __init__(self, machine, seed=7):
        self.machine, self.channels = machine, machine.channels
        n, m = len(self.channels.bpms), len(self.channels.correctors)
        self.blind, self.deaf = np.zeros(n, bool), np.zeros(m, bool)
        self.gain = np.ones(m)
        self.pattern, self.noise, self.again = 0.5e-6, 0.2e-6, 0
        self.missed = 0  # orbits that nobody sees before each that is read
        self._random = np.random.default_rng(seed)
        self._shape = self._random.standard_normal(n)
        self._asked, self._got = machine.setpoints(), machine.setpoints()
        self.past = []

    def read(self, timeout):
        for _ in range(self.missed):
            self.machine.read(timeout)
        reading = self.machine.read(timeout)
        position = reading.orbit.position.copy()
        lies = self.pattern * self._shape + self.noise * self._random.standard_normal(len(position))
        position[self.blind] = lies[self.blind]
        if self.again:
            position = self.past[-self.again].copy()
        self.past.append(position)
        orbit = replace(reading.orbit, position=position)
        return replace(reading, orbit=orbit, readback=self._asked.copy())

    def setpoints(self):
        return self._asked.copy()

    def write(self, setpoints, which=None):
        which = np.ones(len(setpoints), bool) if which is None else which
        self._asked = np.where(which, setpoints, self._asked)
        self._got = np.where(self.deaf, self._got, self.gain * self._asked)
        applied = self.machine.write(self._got)
        return replace(applied, setpoints=self._asked.copy())

    def close(self):
        self.machine.close()


def closed_loop(ring, seed=0, plant=None, dither=None, **interlocks):
    """Build a loop that closes by itself; give the machine, the runner, slot and records."""
    clock, records = ManualClock(), []
    inner = PlantMachine(Plant(ring, "x", plant or PlantSettings(), seed=seed), clock)
    machine = LyingMachine(inner)
    policy = SvdPolicy(inner.plant.nominal_response, SvdSettings())
    slot = PolicySlot(policy)
    runner = Runner(
        machine,
        slot,
        LoopSettings(),
        LimitSettings(),
        InterlockSettings(**interlocks),
        np.zeros(180),
        clock,
        dither,
        start=LoopState.CLOSED,
        subscribers=(records.append,),
        safeguards=Safeguards(policy, without),
        random=np.random.default_rng([seed, 1]),
    )
    return machine, runner, slot, records
