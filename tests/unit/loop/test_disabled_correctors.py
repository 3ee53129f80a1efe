"""A disabled corrector belongs to the operator: nothing is put there, it is taken over as it is."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule
from scripted import RESPONSE, M, N, ScriptedMachine, new_clock

from orbitfb.core.errors import AwayError
from orbitfb.core.signals import LoopState
from orbitfb.loop.excitation.dither import Dither, DitherKind, DitherSettings
from orbitfb.loop.guard import Safeguards
from orbitfb.loop.memory import confirm_setpoints
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.policies.masking import MaskedPolicy, without
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings

STEP = 0.5
RULES = InterlockSettings(
    divergence_ticks=1000, prediction_ticks=0, max_lost_correctors=2, bpm_proving=1
)


class Refusing(SvdPolicy):
    """A law that fails on request."""

    fails = False

    def act(self, error, valid, state):
        if self.fails:
            raise RuntimeError("no idea")
        return super().act(error, valid, state)


class Bench:
    """A loop whose correctors can be disabled, as `enable-correctors` does it."""

    def __init__(self, dither=None, rules=RULES, **keys):
        self.machine = ScriptedMachine(new_clock(), seed=3)
        self.policy = Refusing(RESPONSE, SvdSettings(gain=0.5))
        self.slot = PolicySlot(self.policy)
        self.dither = dither
        self.records = []
        fallback = SvdPolicy(RESPONSE, SvdSettings(gain=0.5))
        self.runner = Runner(
            self.machine,
            self.slot,
            LoopSettings(ramp=0.0, proving=2, **keys),
            LimitSettings(setpoint=5.0, change_per_tick=STEP),
            rules,
            np.zeros(N),
            self.machine.clock,
            dither=dither,
            start=LoopState.CLOSED,
            safeguards=Safeguards(fallback, without),
            subscribers=(self.records.append,),
        )
        self.steps(6)
        assert self.runner.state is LoopState.CLOSED

    def enable(self, *disabled):
        movable = np.ones(M, dtype=bool)
        movable[list(disabled)] = False
        self.slot.redress(
            lambda policy: policy if movable.all() else MaskedPolicy(policy, RESPONSE, movable)
        )
        if self.dither is not None:
            self.dither.retune(movable=movable)

    def steps(self, count):
        return [self.runner.step() for _ in range(count)]


def test_what_an_operator_sets_on_a_disabled_corrector_stays_and_is_recorded():
    bench = Bench()
    bench.enable(1)
    bench.steps(2)
    asked = bench.machine.asked
    bench.machine.inside[1] = 3.0
    bench.machine.disturbance = RESPONSE @ np.array([0.3, 0.0, -0.3, 0.3])
    records = bench.steps(8)
    assert bench.machine.inside[1] == 3.0
    assert all(record.state is LoopState.CLOSED and not record.reason for record in records)
    assert all(record.setpoints[1] == 3.0 and record.applied[1] == 0.0 for record in records)
    assert all(np.isfinite(record.written) for record in records)
    assert bench.machine.asked == asked + 1
    assert not any(put[1] for put in bench.machine.put[-8:])


def test_on_enabling_it_goes_on_from_there_in_limited_steps():
    bench = Bench()
    bench.enable(1)
    bench.steps(2)
    bench.machine.inside[1] = 3.0
    bench.steps(4)
    bench.enable()
    asked, before = bench.machine.asked, bench.machine.inside.copy()
    record = bench.steps(1)[0]
    assert record.state is LoopState.CLOSED and bench.machine.asked == asked + 1
    assert record.setpoints[1] == 3.0 and record.applied[1] != 0.0
    assert np.abs(bench.machine.inside - before).max() <= STEP
    np.testing.assert_allclose(bench.machine.inside, before + record.applied, atol=1e-12)


@pytest.mark.parametrize("tolerance", [None, 0.05])
def test_it_is_taken_over_from_the_setpoint_in_force_though_no_readback_told(tolerance):
    """Switched off, or without readbacks: nothing says that somebody moved its setpoint."""
    bench = Bench(rules=RULES.model_copy(update={"readback_tolerance": tolerance}))
    bench.enable(1)
    bench.steps(2)
    bench.machine.readback_offset[1] = -3.0 - bench.machine.inside[1]
    bench.steps(2)
    bench.machine.inside[1] += 3.0
    bench.machine.readback_offset[1] -= 3.0
    bench.steps(3)
    bench.machine.readback_offset[:] = 0.0
    bench.enable()
    before = bench.machine.inside.copy()
    bench.steps(1)
    assert np.abs(bench.machine.inside - before).max() <= STEP


def test_a_corrector_that_is_off_for_good_is_asked_for_once():
    bench = Bench()
    bench.enable(2)
    bench.steps(2)
    bench.machine.readback_offset[2] = 1.0
    asked = bench.machine.asked
    records = bench.steps(20)
    assert bench.machine.asked == asked + 1
    assert all(record.state is LoopState.CLOSED and not record.reason for record in records)


def test_one_that_cannot_be_asked_holds_nobody_until_it_is_enabled():
    bench = Bench()
    bench.enable(2)
    bench.steps(2)
    bench.machine.readback_offset[2] = 1.0
    bench.machine.setpoints_error = "COR2 does not answer"
    asked = bench.machine.asked
    records = bench.steps(5)
    assert bench.machine.asked == asked + 1  # a question that fails may take its time
    assert all(record.state is LoopState.CLOSED for record in records)
    bench.enable()
    put = len(bench.machine.put)
    record = bench.steps(1)[0]
    assert record.state is LoopState.HELD and "COR2 does not answer" in record.reason
    assert len(bench.machine.put) == put


def test_a_disabled_corrector_that_is_away_is_no_reason_to_hold_or_not_to_close():
    bench = Bench()
    bench.enable(2)
    bench.steps(2)
    machine = bench.machine
    away = np.arange(M) == 2
    plain = machine.setpoints

    def setpoints():
        raise AwayError("COR2 is away", plain(), away)

    machine.setpoints = setpoints
    machine.readback_offset[2] = np.nan
    assert all(record.state is LoopState.CLOSED for record in bench.steps(3))
    bench.runner.command("open")
    bench.steps(1)
    bench.runner.command("close")
    assert bench.steps(1)[0].state is LoopState.CLOSED


def test_an_enabled_corrector_that_somebody_moves_still_holds():
    bench = Bench()
    bench.enable(1)
    bench.steps(2)
    bench.machine.inside[0] += 1.0
    record = bench.steps(1)[0]
    assert record.state is LoopState.HELD
    assert "moved by somebody else: COR0" in record.reason


def test_others_that_were_moved_hold_in_the_very_tick_in_which_one_is_enabled():
    bench = Bench()
    bench.enable(1)
    bench.steps(2)
    bench.machine.inside[:2] += 1.0
    bench.enable()
    record = bench.steps(1)[0]
    assert record.state is LoopState.HELD
    assert record.reason.endswith("moved by somebody else: COR0")


def test_the_baseline_that_steps_in_leaves_disabled_correctors_alone():
    bench = Bench()
    bench.enable(1)
    bench.steps(2)
    bench.policy.fails = True
    bench.machine.disturbance = RESPONSE @ np.full(M, 0.4)
    before = bench.machine.inside[1]
    records = bench.steps(5)
    assert "decides" in records[0].reason
    orbit = records[0].reading.orbit
    others = without(SvdPolicy(RESPONSE, SvdSettings(gain=0.5)), np.arange(M) == 1)
    solved, _ = others.act(orbit.position, orbit.valid, others.initial_state())
    np.testing.assert_allclose(records[0].applied, solved, atol=1e-12)
    assert bench.machine.inside[1] == before
    assert not any(record.applied[1] for record in records)
    bench.machine.inside[1] = 2.0
    bench.steps(3)
    assert bench.machine.inside[1] == 2.0


def test_the_dither_does_not_bring_a_disabled_corrector_back():
    dither = Dither(DitherSettings(orbit_cost=1e-6, kind=DitherKind.PRBS), RESPONSE)
    bench = Bench(dither)
    assert dither.excursion[1] != 0.0
    bench.enable(1)
    before = bench.machine.inside[1]
    bench.steps(3)
    assert bench.machine.inside[1] == before and dither.excursion[1] == 0.0
    bench.machine.inside[1] = 2.0
    bench.steps(2)
    bench.enable()
    bench.steps(1)
    limit = STEP + dither.amplitude
    assert abs(bench.machine.inside[1] - 2.0) <= limit


def test_where_somebody_put_it_is_where_it_has_been_for_what_is_remembered():
    """Neither a readback of before nor good setpoints to return to are of another time."""
    bench = Bench()
    before = bench.runner._engine.memory
    mine, actual = np.arange(M) != 1, before.setpoints + 3.0 * (np.arange(M) == 1)
    memory = replace(before, mine=mine, well=before.setpoints)
    after = confirm_setpoints(memory, actual, 1e-6)
    assert after.well is not None and len(after.recent) == len(before.recent) > 1
    for vector in (after.well, *after.recent):
        assert vector[1] == actual[1]
    for now, then in zip(after.recent[1:], before.recent[1:], strict=True):
        np.testing.assert_array_equal(now[mine], then[mine])


def test_changes_on_their_way_are_seen_though_a_disabled_corrector_is_elsewhere():
    bench = Bench()
    bench.enable(1)
    bench.steps(30)
    bench.machine.setpoints_error = "no answer"  # so that where it is stays unknown
    bench.machine.inside[1] = 4.0
    bench.steps(2)
    bench.machine.setpoints_error = None
    late = bench.machine.inside.copy()
    bench.machine.disturbance = RESPONSE @ np.array([0.4, 0.0, 0.4, 0.4])
    bench.steps(1)
    bench.machine.inside, arrives = late, bench.machine.inside
    record = bench.steps(1)[0]
    assert record.held_back
    bench.machine.inside = arrives
    assert not bench.steps(1)[0].held_back


class Enabling(RuleBasedStateMachine):
    """Any order of disabling, moving by hand, enabling, opening, failing and kicks."""

    def __init__(self):
        super().__init__()
        self.bench = Bench()
        self.machine = self.bench.machine
        self.disabled: set[int] = set()
        plain = self.machine.write

        def write(setpoints, which=None):
            allowed = np.isin(np.arange(M), sorted(self.disabled), invert=True)
            assert which is not None and not (which & ~allowed).any()
            step = np.abs(setpoints - self.machine.inside)[which]
            assert step.max(initial=0.0) <= STEP + 1e-12  # from where the hardware is
            return plain(setpoints, which)

        self.machine.write = write

    @rule(which=st.integers(0, M - 1))
    def disable(self, which):
        if len(self.disabled | {which}) < M:
            self.disabled.add(which)
            self.bench.enable(*self.disabled)

    @rule(which=st.integers(0, M - 1))
    def enable(self, which):
        self.disabled.discard(which)
        self.bench.enable(*self.disabled)

    @rule(which=st.integers(0, M - 1), to=st.floats(-4.9, 4.9), told=st.booleans())
    def move_by_hand(self, which, to, told):
        """Of a disabled corrector; its readback may be that of a power supply that is off."""
        if which in self.disabled:
            change = to - self.machine.inside[which]
            self.machine.inside[which] = to
            if not told:
                self.machine.readback_offset[which] -= change

    @rule(fails=st.booleans())
    def policy(self, fails):
        self.bench.policy.fails = fails

    @rule(kick=st.floats(-30e-6, 30e-6))
    def disturb(self, kick):
        self.machine.disturbance = np.linspace(-kick, kick, N)

    @rule(command=st.sampled_from(("open", "shadow", "close")))
    def command(self, command):
        on = [index for index in range(M) if index not in self.disabled]
        if command == "close":
            self.machine.readback_offset[on] = 0.0
        if self.bench.runner.state in (LoopState.OPEN, LoopState.SHADOW, LoopState.CLOSED):
            self.bench.runner.command(command)
            self.bench.steps(1)

    @rule(count=st.sampled_from((1, 2, 5)))
    def ticks(self, count):
        for _ in range(count):
            before = self.machine.inside.copy()
            self.bench.steps(1)
            for index in self.disabled:
                assert self.machine.inside[index] == before[index]

    @invariant()
    def nothing_failed(self):
        assert self.bench.runner.state is not LoopState.FAULT, self.bench.runner.failure


Enabling.TestCase.settings = settings(
    max_examples=30, stateful_step_count=25, deadline=None, derandomize=True
)
TestEnabling = Enabling.TestCase
