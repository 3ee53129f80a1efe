"""An IOC comes back after a restart, its channels in waves and its stored current later still."""

import numpy as np
import pytest
from scripted import RESPONSE, M, N, ScriptedMachine, new_clock

from orbitfb.core.signals import LoopState, Reading
from orbitfb.loop.guard import Safeguards
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.policies.masking import without
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings


class Waves(ScriptedMachine):
    """A machine whose readbacks say what they are told to."""

    def __init__(self):
        super().__init__(new_clock())
        self.said = None

    def read(self, timeout):
        its = super().read(timeout)
        readback = its.readback if self.said is None else self.said
        return Reading(its.orbit, readback, its.auxiliary, its.received)


@pytest.fixture
def closed():
    machine = Waves()
    policy = SvdPolicy(RESPONSE, SvdSettings(gain=0.5))
    runner = Runner(
        machine,
        PolicySlot(policy),
        LoopSettings(ramp=0.0, proving=2),
        LimitSettings(setpoint=5.0, change_per_tick=5.0),
        InterlockSettings(max_lost_correctors=1, divergence_ticks=1000),
        np.zeros(N),
        machine.clock,
        start=LoopState.CLOSED,
        safeguards=Safeguards(policy, without),
    )
    for _ in range(5):
        runner.step()
    assert runner.state is LoopState.CLOSED
    return machine, runner


def test_readbacks_that_come_back_in_waves_with_what_they_said_before_only_hold(closed):
    machine, runner = closed
    old = np.full(M, 0.5)
    machine.script.append("missing")
    runner.step()
    machine.inside = np.zeros(M)  # restarted
    machine.said = np.full(M, np.nan)
    for _ in range(6):
        assert runner.step().state is LoopState.HELD
    machine.said = old  # for a moment: connected, and not heard of since
    assert runner.step().state is LoopState.HELD
    machine.said = None
    for _ in range(4):
        record = runner.step()
    assert record.state is LoopState.CLOSED, record.reason


def test_readbacks_that_stay_away_from_their_setpoints_still_trip(closed):
    machine, runner = closed
    machine.said = np.full(M, np.nan)
    for _ in range(6):
        assert runner.step().state is not LoopState.TRIPPED
    machine.said = np.full(M, 0.5)
    assert [runner.step().state for _ in range(3)][-1] is LoopState.TRIPPED


@pytest.mark.parametrize("between", [[], ["missing"], ["current_unknown"] * 3])
def test_a_stored_current_that_drops_while_held_trips(closed, between):
    machine, runner = closed
    machine.script.extend(["missing", *between])
    for _ in range(1 + len(between)):
        runner.step()
    assert runner.state in (LoopState.HELD, LoopState.TRIPPED)
    machine.current = 0.25
    record = runner.step()
    assert record.state is LoopState.TRIPPED
    assert record.reason == "the stored current dropped from 400 to 250 mA"


def test_a_stored_current_that_is_as_it_was_does_not_trip_when_it_is_known_again(closed):
    machine, runner = closed
    machine.script.extend(["missing", "current_unknown", "current_unknown"])
    for _ in range(3):
        runner.step()
    machine.current = 0.39
    assert [runner.step().state for _ in range(4)][-1] is LoopState.CLOSED
