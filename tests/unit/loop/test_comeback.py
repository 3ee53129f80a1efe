"""Back to the last good setpoints after a trip for the orbit: in steps, or not at all."""

import numpy as np
import pytest
from scripted import InversePolicy, M, N, ScriptedMachine, new_clock

from orbitfb.core.signals import LoopState
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings

STEP = 0.5


class Away:
    """Corrects until it is told to push the orbit away."""

    policy_id = "away"

    def __init__(self):
        self.inside, self.pushes = InversePolicy(), False

    def initial_state(self):
        return 0

    def act(self, error, valid, state):
        change, state = self.inside.act(error, valid, state)
        return (np.array([2.0, -2.0, 2.0, -1.0]) if self.pushes else change), state


class Bench:
    """A loop whose policy has just driven the orbit to a trip."""

    def __init__(self, returns=True, good=20e-6, **interlocks):
        self.machine = ScriptedMachine(new_clock())
        self.machine.disturbance = np.linspace(-40e-6, 40e-6, N)
        self.policy = Away()
        loop = LoopSettings(
            ramp=0.0, return_after_trip=returns, return_step=STEP, return_good=good, proving=2
        )
        limits = LimitSettings(setpoint=50.0, change_per_tick=10.0)
        self.interlocks = InterlockSettings(
            bpm_proving=1, bpm_jump=1.0, **({"distortion_rms": 3e-4} | interlocks)
        )
        self.runner = Runner(
            self.machine,
            PolicySlot(self.policy),
            loop,
            limits,
            self.interlocks,
            np.zeros(N),
            self.machine.clock,
        )
        self.runner.command("close")
        for _ in range(12):
            self.runner.step()
        self.good = self.machine.inside.copy()
        self.policy.pushes = True
        self.record = self.step(30, LoopState.TRIPPED)
        self.tripped = len(self.machine.writes)
        self.left = self.machine.inside.copy()

    def step(self, most, until):
        for _ in range(most):
            record = self.runner.step()
            if record.state is until:
                return record
        raise AssertionError(record)

    def ticks(self, count):
        return [self.runner.step() for _ in range(count)][-1]

    @property
    def returned(self):
        return np.array([self.left, *self.machine.writes[self.tripped :]])


def test_it_goes_back_in_limited_steps_and_stays_tripped():
    bench = Bench()
    assert "exceeds 300 µm" in bench.record.reason
    records = [bench.runner.step() for _ in range(60)]
    assert {record.state for record in records} == {LoopState.TRIPPED}
    steps = np.diff(bench.returned, axis=0)
    assert len(steps) > 10 and np.abs(steps).max() <= STEP + 1e-12
    assert not np.isfinite(records[0].written)  # what is under way arrives first
    np.testing.assert_allclose(bench.machine.inside, bench.good, atol=0.5)
    assert np.sqrt(np.mean(records[-1].reading.orbit.position ** 2)) < 30e-6
    told = f"; returned to the last good setpoints in {len(steps)} steps"
    assert records[-1].reason == bench.record.reason + told
    assert sum(np.isfinite(record.written) for record in records) == len(steps)
    bench.runner.command("reset")
    assert bench.ticks(1).state is LoopState.OPEN


def test_the_rate_of_the_distortion_trips_too_and_it_goes_back():
    bench = Bench(distortion_rms=1e-2, distortion_max=1e-2, divergence_ticks=1000)
    assert "allowed: 500 µm/s" in bench.record.reason
    assert "returned to the last good" in bench.ticks(60).reason


def test_by_default_the_setpoints_stay():
    bench = Bench(returns=False)
    assert bench.ticks(30).reason == bench.record.reason
    assert len(bench.machine.writes) == bench.tripped


def test_without_good_setpoints_they_stay():
    bench = Bench(good=1e-12)
    assert bench.ticks(30).reason.endswith("no good setpoints are known: they stay")
    assert len(bench.machine.writes) == bench.tripped


def wrong(bench, what):
    machine = bench.machine
    if what in ("missing", "beam_lost", "current_unknown", "many_nan", "same_stamp", "frozen"):
        machine.script.append(what)
    elif what == "moved":
        machine.inside[1] += 3.0
    elif what == "write":
        machine.write_error = "refused"
    elif what == "not known":
        machine.setpoints_error = "no answer"
    elif what == "corrector":
        machine.readback_offset[2] = 5.0
    elif what == "worse":
        machine.disturbance = 20 * machine.disturbance
    elif what == "reset":
        bench.runner.command("reset")


@pytest.mark.parametrize(
    "what",
    ["missing", "beam_lost", "current_unknown", "many_nan", "same_stamp", "frozen", "moved",
     "write", "not known", "corrector", "worse", "reset"],
)  # fmt: skip
def test_it_stops_at_once_if_anything_is_wrong(what):
    bench = Bench()
    bench.ticks(6)
    tried = len(bench.machine.writes)
    assert tried > bench.tripped
    wrong(bench, what)
    record = bench.ticks(1)
    assert len(bench.machine.writes) == tried + (what == "write")
    if what == "reset":
        assert record.state is LoopState.OPEN
    else:
        assert "; return stopped after" in record.reason
        assert record.reason.startswith(bench.record.reason)
    bench.machine.write_error = bench.machine.setpoints_error = None
    bench.machine.readback_offset = np.zeros(M)
    bench.ticks(5)  # and does not go on once all is well
    assert len(bench.machine.writes) == tried + (what == "write")


@pytest.mark.parametrize("ring", ["beam_lost", "operator"])
def test_only_the_orbit_makes_it_go_back(ring):
    bench = Bench()
    bench.policy.pushes = False
    bench.ticks(60)
    bench.runner.command("reset")
    bench.ticks(1)
    bench.runner.command("close")
    bench.ticks(10)
    tried = len(bench.machine.writes)
    if ring == "operator":
        bench.runner.command("open")
    else:
        bench.machine.script.append("beam_lost")
    bench.ticks(10)
    assert len(bench.machine.writes) == tried
