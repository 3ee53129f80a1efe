"""Policies that fail, correctors that are lost or full, a response that is wrong."""

import time
from dataclasses import replace

import numpy as np
import pytest

from orbitfb.core.clock import ManualClock
from orbitfb.core.errors import ControlError
from orbitfb.core.signals import LoopState
from orbitfb.loop.guard import Safeguards
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant
from orbitfb.physics.plant_machine import PlantMachine
from orbitfb.policies.masking import without
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings

RING = Ring.load()
RUN = 300
RESPONSE = Plant(RING, "x", seed=0).nominal_response


class Bad:
    """A policy that behaves until it is told not to."""

    policy_id = "bad"

    def __init__(self, clock):
        self.inside, self.kind, self.clock = SvdPolicy(RESPONSE, SvdSettings()), "good", clock

    def initial_state(self):
        return self.inside.initial_state()

    def act(self, error, valid, state):
        change, after = self.inside.act(error, valid, state)
        if self.kind == "raises":
            raise RuntimeError("no idea")
        if self.kind == "nan":
            change = change * np.nan
        if self.kind == "shape":
            change = change[1:]
        if self.kind == "slow":
            self.clock.advance(0.11)
        return change, after


class Bench:
    def __init__(
        self, policy=None, seed=0, limits=None, fallback=True, response=RESPONSE,
        interlocks=None, **keys,
    ):  # fmt: skip
        # The questions of the loop are drawn without a seed; they have tests of their own.
        self.obstacle = ""
        self.clock, self.records = ManualClock(), []
        self.plant = Plant(RING, "x", seed=seed)
        self.machine = PlantMachine(self.plant, self.clock)
        self.bad = Bad(self.clock)
        self.slot = PolicySlot(policy or self.bad)
        self.baseline = SvdPolicy(response, SvdSettings(gain=0.6), "baseline")
        self.runner = Runner(
            self.machine,
            self.slot,
            LoopSettings(**keys),
            limits or LimitSettings(),
            interlocks or InterlockSettings(answer_reach=None),
            np.zeros(180),
            self.clock,
            start=LoopState.CLOSED,
            subscribers=(self.records.append,),
            safeguards=Safeguards(
                self.baseline if fallback else None, without, lambda: self.obstacle
            ),
        )

    def steps(self, count):
        return [self.runner.step() for _ in range(count)][-1]


@pytest.mark.parametrize("kind", ["raises", "nan", "shape"])
def test_the_baseline_decides_in_the_very_tick_in_which_a_policy_fails(kind):
    bench = Bench()
    bench.steps(30)
    bench.bad.kind = kind
    record = bench.runner.step()
    assert record.state is LoopState.CLOSED and record.policy_id == "baseline"
    assert np.isfinite(record.written) and record.applied.any()
    assert record.reason.startswith("policy bad ") and "baseline decides" in record.reason
    record = bench.steps(20)
    assert record.policy_id == "baseline" and "baseline decides" in record.reason
    assert bench.machine.true_orbit_rms < 1e-6
    bench.slot.swap(SvdPolicy(RESPONSE, SvdSettings(), "another"))
    record = bench.steps(2)
    assert (record.policy_id, record.reason) == ("another", "")


class Pupil(Bad):
    """A policy that is told what was sent, and may fail at it."""

    policy_id = "pupil"

    def __init__(self, clock):
        super().__init__(clock)
        self.told = []

    def inform(self, error, valid, applied, state):
        if self.kind == "deaf":
            raise FloatingPointError("no number")
        if self.kind == "ponders":
            self.clock.advance(0.11)
        self.told.append((error, valid, applied))
        return state

    def take_back(self):
        self.told.clear()


def test_a_policy_that_learns_is_told_what_was_sent_in_every_tick_that_sends():
    bench = Bench()
    pupil = Pupil(bench.clock)
    bench.slot.swap(pupil)
    bench.steps(40)
    sent = [record for record in bench.records if np.isfinite(record.written)]
    assert len(pupil.told) == len(sent) > 20
    for (error, valid, applied), record in zip(pupil.told, sent, strict=True):
        np.testing.assert_array_equal(applied, record.applied)
        np.testing.assert_array_equal(error[valid], record.reading.orbit.position[valid])
    bench.runner.command("open")
    bench.steps(3)
    assert len(pupil.told) == len(sent)


def test_a_policy_that_learns_takes_back_what_it_learnt_when_the_loop_trips():
    bench = Bench()
    pupil = Pupil(bench.clock)
    bench.slot.swap(pupil)
    assert bench.steps(40).state is LoopState.CLOSED and pupil.told
    bench.plant.kick(5e-3)
    assert bench.steps(3).state is LoopState.TRIPPED
    assert not pupil.told


def test_the_baseline_goes_on_when_a_policy_cannot_learn():
    bench = Bench()
    pupil = Pupil(bench.clock)
    bench.slot.swap(pupil)
    bench.steps(30)
    pupil.kind = "deaf"
    assert bench.steps(2).state is LoopState.CLOSED
    record = bench.steps(1)
    assert record.policy_id == "baseline"
    assert "policy pupil could not learn, FloatingPointError: no number" in record.reason
    assert bench.steps(20).state is LoopState.CLOSED


def test_a_slow_policy_is_put_aside_after_three_strikes():
    bench = Bench(hold_after=3.0)
    bench.steps(30)
    bench.bad.kind = "slow"
    record = bench.runner.step()
    assert "longer than 100 ms: baseline decides" in record.reason
    bench.bad.kind = "good"
    assert bench.runner.step().policy_id == "bad"
    bench.bad.kind = "slow"
    for _ in range(6):
        record = bench.runner.step()
    assert record.policy_id == "baseline"


def test_a_policy_that_learns_too_long_is_put_aside_after_three_ticks():
    bench = Bench(hold_after=3.0)
    pupil = Pupil(bench.clock)
    bench.slot.swap(pupil)
    bench.steps(30)
    pupil.kind = "ponders"
    for _ in range(3):
        record = bench.runner.step()
        assert record.policy_id == "pupil" and not record.reason
    record = bench.runner.step()
    assert record.policy_id == "baseline"
    assert "policy pupil took 110 ms to learn and decide, longer than 100 ms" in record.reason
    assert bench.steps(20).state is LoopState.CLOSED


def test_a_machine_that_must_not_be_written_to_keeps_the_loop_from_closing():
    bench = Bench()
    bench.obstacle = "the drive limits are narrower"
    record = bench.steps(30)
    assert (record.state, record.reason) == (LoopState.HELD, bench.obstacle)
    bench.runner.command("open")
    bench.steps(1)
    refused = bench.runner.command("close")
    bench.steps(1)
    with pytest.raises(ControlError, match="the drive limits are narrower"):
        refused.result(timeout=0)
    assert all(np.isnan(record.written) for record in bench.records)
    bench.obstacle = ""
    bench.runner.command("close")
    assert bench.steps(2).state is LoopState.CLOSED


def test_an_operator_who_closes_anew_gives_the_policy_another_chance():
    bench = Bench()
    bench.steps(30)
    bench.bad.kind = "raises"
    assert bench.runner.step().policy_id == "baseline"
    bench.bad.kind = "good"
    bench.runner.command("open")
    bench.steps(2)
    bench.runner.command("close")
    assert bench.steps(2).policy_id == "bad"


def test_a_corrector_at_its_limit_leaves_the_solution_and_the_rest_take_over():
    policy = SvdPolicy(RESPONSE, SvdSettings())
    free = Bench(policy)
    free.steps(60)
    wanted = np.abs(free.records[-1].setpoints)
    limit = float(np.sort(wanted)[-4])  # three would go beyond
    bench = Bench(policy, limits=LimitSettings(setpoint=limit))
    record = bench.steps(60)
    assert record.state is LoopState.CLOSED
    assert "are left out" in record.reason
    assert max(np.abs(its.setpoints).max() for its in bench.records) <= limit
    pinned = Bench(policy, limits=LimitSettings(setpoint=limit))
    pinned.runner._engine._guard._without = None  # as it was: the whole change is scaled
    pinned.steps(60)
    assert bench.machine.true_orbit_rms < 0.2 * pinned.machine.true_orbit_rms


def test_a_corrector_is_warned_of_before_its_limit():
    policy = SvdPolicy(RESPONSE, SvdSettings())
    free = Bench(policy)
    free.steps(60)
    setpoints = np.abs(free.records[-1].setpoints)
    worst = free.machine.channels.correctors[int(setpoints.argmax())]
    bench = Bench(policy, limits=LimitSettings(setpoint=float(setpoints.max()) * 1.05))
    assert bench.steps(60).reason.endswith(f" A: {worst}")
    assert "1 correctors beyond 90% of" in bench.records[-1].reason


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("wrong", ["sign", "bpms", "correctors"])
def test_a_wrong_response_trips_a_few_ticks_after_closing(wrong, seed):
    order = np.random.default_rng(seed).permutation(180)
    response = {"sign": -RESPONSE, "bpms": RESPONSE[order], "correctors": RESPONSE[:, order]}[wrong]
    bench = Bench(SvdPolicy(response, SvdSettings()), seed)
    for _ in range(60):
        if bench.runner.step().state is LoopState.TRIPPED:
            break
    record = bench.records[-1]
    assert record.state is LoopState.TRIPPED
    assert "does not answer as the response matrix says" in record.reason
    closed = [its for its in bench.records if its.state is LoopState.CLOSED]
    assert len(closed) < 8
    assert max(np.sqrt(np.mean(its.reading.orbit.position**2)) for its in bench.records) < 0.7e-3


@pytest.mark.parametrize("gain", [0.3, 1.0])
def test_a_right_response_is_not_called_wrong_by_kicks_and_waves(gain):
    believed = InterlockSettings(answer_reach=None)  # a loop that waits lets kicks add up
    bench = Bench(SvdPolicy(RESPONSE, SvdSettings(gain=gain)), ramp=0.0, interlocks=believed)
    random = np.random.default_rng(3)
    plant = bench.machine.plant
    for _ in range(RUN):
        if random.random() < 0.2:
            plant.kick(float(random.uniform(1e-6, 100e-6)))
        assert bench.runner.step().state is not LoopState.TRIPPED, bench.runner.reason


def test_leaving_a_corrector_out_costs_little_time():
    baseline = SvdPolicy(RESPONSE, SvdSettings())
    lost = np.arange(180) == 7
    begin = time.perf_counter()
    policy = without(baseline, lost)
    assert time.perf_counter() - begin < 1.0  # about 20 ms; once for every corrector that is lost
    change, _ = policy.act(np.ones(180) * 1e-5, np.ones(180, dtype=bool), policy.initial_state())
    assert change[7] == 0.0 and change.any()


def test_a_policy_that_cannot_be_solved_anew_moves_no_corrector_that_is_left_out():
    bench = Bench(limits=LimitSettings(setpoint=100.0))
    assert not hasattr(bench.bad, "response")
    bench.steps(30)
    lost = np.arange(180) == 7
    memory = bench.runner._engine.memory
    bench.runner._engine.memory = replace(memory, lost=lost)
    bench.machine.plant.kick(50e-6)
    before = memory.setpoints[7]
    assert bench.steps(10).setpoints[7] == pytest.approx(before, abs=1e-12)
    assert bench.records[-1].applied.any()
