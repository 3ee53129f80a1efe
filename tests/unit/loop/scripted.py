"""A small linear ring that does what a script says, on a clock moved by hand."""

from collections import deque

import numpy as np

from orbitfb.core.clock import ManualClock
from orbitfb.core.errors import MachineError, NoOrbitError, WriteError
from orbitfb.core.signals import Applied, Channels, Orbit, Reading

N, M, PERIOD = 6, 4, 0.1
RESPONSE = np.random.default_rng(11).standard_normal((N, M)) * 2e-5


def channels(n=N, m=M):
    bpms = tuple(f"BPM{i}" for i in range(n))
    correctors = tuple(f"COR{i}" for i in range(m))
    return Channels("x", bpms, correctors, bpms, correctors, correctors)


class ScriptedMachine:
    """Each read takes the next event off the script; without one the orbit is good."""

    def __init__(self, clock, seed=0):
        self.clock, self.channels = clock, channels()
        self.script = deque()
        self.disturbance = np.zeros(N)
        self.inside = np.zeros(M)
        self.reads, self.writes, self.put, self.asked = [], [], [], 0
        self.write_error = self.setpoints_error = None
        self.readback_offset = np.zeros(M)
        self.current = 0.4
        self.last = None
        self._random = np.random.default_rng(seed)
        self.on_read = None

    def read(self, timeout):
        if self.on_read:
            self.on_read()
        event = self.script.popleft() if self.script else "good"
        self.reads.append((event, timeout))
        if event == "missing":
            self.clock.advance(max(timeout, 0.0))
            raise NoOrbitError("the script says so")
        if isinstance(event, Exception):
            raise event
        self.clock.advance(PERIOD)
        noise = 0.2e-6 * self._random.standard_normal(N)
        position = RESPONSE @ self.inside + self.disturbance + noise
        stamp = self.clock.wall()
        if event == "same_stamp" and self.last:
            stamp = self.last.time
        if event == "frozen" and self.last:
            position = self.last.position.copy()
        valid = np.ones(N, dtype=bool)
        if event == "one_nan":
            position[0] = np.nan  # claims to be valid: must be masked all the same
        if event == "many_nan":
            position[:4], valid[:4] = np.nan, False
        current = {"beam_lost": 0.0, "current_unknown": np.nan}.get(event, self.current)
        orbit = self.last = Orbit(position, valid, stamp)
        readback = self.inside + self.readback_offset
        return Reading(orbit, readback, {"current": current}, self.clock.monotonic())

    def setpoints(self):
        self.asked += 1
        if self.setpoints_error:
            raise MachineError(self.setpoints_error)
        return self.inside.copy()

    def write(self, setpoints, which=None):
        which = np.ones(M, dtype=bool) if which is None else which
        self.writes.append(setpoints.copy())
        self.put.append(which.copy())
        if self.write_error:
            first = np.flatnonzero(which)[:1]
            self.inside[first] = setpoints[first]  # one had left when it failed
            raise WriteError(self.write_error)
        self.inside = np.where(which, setpoints, self.inside)
        return Applied(setpoints, self.clock.wall(), self.clock.monotonic())

    def close(self):
        pass


class InversePolicy:
    """A damped inverse, without mercy for masks: invalid rows are zero."""

    def __init__(self, name="inverse", gain=0.5):
        self.policy_id = name
        self._law = -gain * np.linalg.pinv(RESPONSE)
        self.started = 0

    def initial_state(self):
        self.started += 1
        return 0

    def act(self, error, valid, state):
        assert np.isfinite(error).all()
        return self._law @ error, state + 1


class ConstantPolicy:
    """Wants the same whatever the orbit."""

    def __init__(self, change, name="constant"):
        self.policy_id, self._change = name, np.asarray(change, dtype=float)

    def initial_state(self):
        return None

    def act(self, error, valid, state):
        if not self._change.size:
            raise RuntimeError("no idea")
        return self._change, state


def new_clock():
    return ManualClock(1e9)
