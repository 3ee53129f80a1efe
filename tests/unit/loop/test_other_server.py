"""PVs that come from another server hold the loop until an operator closes it."""

from dataclasses import replace

import numpy as np
import pytest
from scripted import PERIOD, RESPONSE, N, ScriptedMachine, new_clock

from orbitfb.core.signals import LoopState
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.loop.timing.pacing import Pace, see, slower
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings


class Moving(ScriptedMachine):
    """A machine whose PVs move to another server."""

    def __init__(self):
        super().__init__(new_clock())
        self.moves = 0

    def read(self, timeout):
        return replace(super().read(timeout), moves=self.moves, moved=f"move {self.moves}")


def steps(runner, count):
    return [runner.step().state for _ in range(count)]


def command(runner, name):
    future = runner.command(name)
    runner.step()
    return future.result(0)


@pytest.fixture
def closed():
    machine = Moving()
    runner = Runner(
        machine,
        PolicySlot(SvdPolicy(RESPONSE, SvdSettings(gain=0.5))),
        LoopSettings(rate_hz=1 / PERIOD, ramp=0.0, proving=2),
        LimitSettings(setpoint=5.0, change_per_tick=5.0),
        InterlockSettings(divergence_ticks=1000),
        np.zeros(N),
        machine.clock,
        start=LoopState.CLOSED,
    )
    assert steps(runner, 5)[-1] is LoopState.CLOSED
    return machine, runner


def test_a_move_while_closed_holds_until_an_operator_closes(closed):
    machine, runner = closed
    machine.moves = 3
    writes = len(machine.writes)
    assert set(steps(runner, 20)) == {LoopState.HELD}
    assert runner.reason == "move 3" and len(machine.writes) == writes
    assert command(runner, "close") is LoopState.CLOSED
    assert set(steps(runner, 10)) == {LoopState.CLOSED}


def test_a_move_during_an_outage_keeps_the_loop_from_closing_by_itself(closed):
    machine, runner = closed
    machine.script.extend(["missing"] * 3)
    steps(runner, 3)
    assert runner.state is LoopState.HELD and runner.reason != "move 1"
    machine.moves = 1
    assert set(steps(runner, 20)) == {LoopState.HELD}
    assert runner.reason == "move 1"
    machine.script.append("missing")
    steps(runner, 1)
    assert runner.reason != "move 1"  # what is wrong now comes first
    assert set(steps(runner, 5)) == {LoopState.HELD} and runner.reason == "move 1"


def test_the_next_outage_after_an_operator_closed_ends_by_itself_again(closed):
    machine, runner = closed
    machine.moves = 1
    steps(runner, 3)
    command(runner, "close")
    machine.script.extend(["missing"] * 3)
    steps(runner, 3)
    assert steps(runner, 5)[-1] is LoopState.CLOSED


def test_a_move_while_open_is_known_when_the_loop_is_closed(closed):
    machine, runner = closed
    command(runner, "open")
    machine.moves = 2
    steps(runner, 2)
    assert command(runner, "close") is LoopState.CLOSED
    assert set(steps(runner, 5)) == {LoopState.CLOSED}


@pytest.mark.parametrize(("orbits", "told"), [(5.0, True), (11.0, True), (15.0, False)])
def test_orbits_that_come_less_often_than_the_loop_ticks_are_told(orbits, told):
    pace, period = Pace(), 1 / 20.0
    for tick in range(40):
        _, pace = see(1e9 + tick / orbits, pace, period)
    text = slower(pace, period)
    assert bool(text) == told
    if told:
        assert text.startswith("orbits come at ") and text.endswith(", loop.rate_hz is 20")
        assert float(text.split()[3]) == pytest.approx(orbits, rel=0.05)
    assert not slower(Pace(), period)


def test_an_outage_is_no_other_rate():
    pace = Pace()
    for time in (0.0, 0.1, 0.2, 60.0, 60.1, 120.0, 120.1):
        _, pace = see(1e9 + time, pace, 0.1)
    assert not slower(pace, 0.1)
