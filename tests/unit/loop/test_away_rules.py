"""Correctors come and go in any order: an independent model says who may be written."""

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule
from scripted import RESPONSE, M, N, ScriptedMachine, new_clock

from orbitfb.core.errors import AwayError, WriteError
from orbitfb.core.signals import Applied, LoopState, Reading
from orbitfb.loop.guard import Safeguards
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.policies.masking import without
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings

MOST = 2


class PartlyAway(ScriptedMachine):
    """A machine whose correctors come and go; what comes back may have been restarted."""

    def __init__(self):
        super().__init__(new_clock(), seed=1)
        self.gone, self.unread = np.zeros(M, bool), np.zeros(M, bool)
        self.last = None
        self.known = np.zeros(M)

    def read(self, timeout):
        its = super().read(timeout)
        readback = np.where(self.gone, np.nan, its.readback)
        away = self.gone.copy() if self.gone.any() else None
        return Reading(its.orbit, readback, its.auxiliary, its.received, away)

    def setpoints(self):
        here = ~self.gone
        self.known[here], self.unread[here] = self.inside[here], False
        if self.gone.any():
            raise AwayError("some are away", self.known.copy(), self.gone.copy())
        return self.inside.copy()

    def write(self, setpoints, which=None):
        which = np.ones(M, bool) if which is None else which
        self.writes.append(setpoints.copy())
        if (which & (self.gone | self.unread)).any():
            raise WriteError("away, or not read since")
        assert np.abs(setpoints - self.inside)[which].max(initial=0.0) <= 0.5 + 1e-12
        self.inside = np.where(which, setpoints, self.inside)
        self.known = np.where(which, setpoints, self.known)
        return Applied(setpoints, self.clock.wall(), self.clock.monotonic())


class CorrectorsComeAndGo(RuleBasedStateMachine):
    def __init__(self):
        super().__init__()
        self.machine = PartlyAway()
        policy = SvdPolicy(RESPONSE, SvdSettings(gain=0.5))
        self.runner = Runner(
            self.machine,
            PolicySlot(policy),
            LoopSettings(ramp=0.0, proving=2),
            LimitSettings(setpoint=5.0, change_per_tick=0.5),
            InterlockSettings(max_lost_correctors=MOST, bpm_proving=1, divergence_ticks=1000),
            np.zeros(N),
            self.machine.clock,
            start=LoopState.CLOSED,
            safeguards=Safeguards(policy, without),
        )
        self.lost: set[int] = set()  # the model: who was away while the loop was closed or held

    @rule(which=st.integers(0, M - 1))
    def goes(self, which):
        self.machine.gone[which] = True

    @rule(which=st.integers(0, M - 1), restarted=st.booleans())
    def comes(self, which, restarted):
        if self.machine.gone[which]:
            self.machine.gone[which], self.machine.unread[which] = False, True
            if restarted:
                self.machine.inside[which] = 0.0

    @rule(kick=st.floats(-30e-6, 30e-6))
    def disturb(self, kick):
        self.machine.disturbance = np.linspace(-kick, kick, N)

    @rule()
    def anew(self):
        if self.runner.state in (LoopState.CLOSED, LoopState.HELD):
            self.runner.command("open")
            self.runner.step()
            self.lost = set()
            order = self.runner.command("close")
            self.runner.step()
            assert (order.exception() is not None) == bool(self.machine.gone.any())

    @rule(count=st.sampled_from((1, 2, 8)))
    def ticks(self, count):
        for _ in range(count):
            before, tried = self.machine.inside.copy(), len(self.machine.writes)
            gone = set(np.flatnonzero(self.machine.gone).tolist())
            active = self.runner.state in (LoopState.CLOSED, LoopState.HELD)
            wanted = self.lost | gone
            if active and len(wanted) <= MOST:
                self.lost = wanted
            record = self.runner.step()
            if active and len(wanted) > MOST and gone - self.lost:
                assert record.state is LoopState.HELD and len(self.machine.writes) == tried
            for index in self.lost | gone:
                assert self.machine.inside[index] == before[index]  # never moved
            assert record.state is not LoopState.TRIPPED, record.reason
        if active and count == 8 and self.lost | gone == self.lost:  # quiet for long enough
            assert record.state is LoopState.CLOSED, record.reason
            assert np.isfinite(record.written) or len(self.lost) == M

    @invariant()
    def nothing_is_beyond_its_limit(self):
        assert np.isfinite(self.machine.inside).all()
        assert np.abs(self.machine.inside).max() <= 5.0


CorrectorsComeAndGo.TestCase.settings = settings(
    max_examples=25, stateful_step_count=25, deadline=None, derandomize=True
)
TestCorrectorsComeAndGo = CorrectorsComeAndGo.TestCase
