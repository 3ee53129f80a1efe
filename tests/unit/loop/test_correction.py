"""A change by hand while the loop is open: in steps, checked as a loop that closes, undone."""

import numpy as np
import pytest
from scripted import RESPONSE, InversePolicy, M, N, ScriptedMachine, new_clock

from orbitfb.core.errors import ControlError
from orbitfb.core.signals import LoopState
from orbitfb.loop.correction.move import Move
from orbitfb.loop.correction.settings import CorrectionSettings
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings

STEP = 0.5
KICK = np.array([1.2, -0.7, 0.0, 0.3])
"""Setpoints that a good orbit does not need [A]."""


class Bench:
    """An open loop on a ring whose correctors are not where they should be."""

    def __init__(self, depth=20, kick=KICK, setpoint=50.0):
        self.machine = ScriptedMachine(new_clock())
        self.machine.inside = kick.copy()
        self.policy = InversePolicy()
        self.runner = Runner(
            self.machine,
            PolicySlot(self.policy),
            LoopSettings(ramp=0.0, proving=2),
            LimitSettings(setpoint=setpoint, change_per_tick=10.0),
            InterlockSettings(bpm_proving=1, bpm_jump=1.0, distortion_rms=3e-4),
            np.zeros(N),
            self.machine.clock,
            correction=CorrectionSettings(step=STEP, undo_depth=depth),
        )
        self.ticks(3)

    def ticks(self, count):
        return [self.runner.step() for _ in range(count)][-1]

    def rms_of(self, setpoints):
        return float(np.sqrt(np.mean((RESPONSE @ setpoints) ** 2)))

    def order(self, aim, name="correction", undoes=None):
        start = self.machine.inside.copy()
        move = Move(name, start, np.asarray(aim, float), self.rms_of(np.asarray(aim)))
        return self.runner.hand.order(move, undoes)

    def undo(self):
        last = self.runner.hand.made[-1]
        move = Move("undo", last.left, last.start, self.rms_of(last.start))
        return self.runner.hand.order(move, last)


def test_it_goes_in_limited_steps_and_tells_what_came_of_it():
    bench = Bench()
    outcome = bench.order(np.zeros(M))
    records = [bench.runner.step() for _ in range(8)]
    steps = np.diff([KICK, *bench.machine.writes], axis=0)
    assert len(steps) == 3 and np.abs(steps).max() == pytest.approx(STEP)
    np.testing.assert_array_equal(bench.machine.inside, np.zeros(M))
    done = outcome.result(0)
    assert done.steps == 3 and done.before == pytest.approx(bench.rms_of(KICK), rel=0.1)
    assert done.after < 1e-6
    assert {record.state for record in records} == {LoopState.OPEN}
    moved = sum(record.applied for record in records)
    np.testing.assert_allclose(moved, -KICK)  # the records tell it
    assert bench.ticks(5).applied.any() is np.False_ and len(bench.machine.writes) == 3


def test_the_last_ones_are_undone_one_by_one_and_no_more():
    bench = Bench(depth=3)
    places = [KICK]
    for number in range(4):
        places.append(KICK + 0.1 * (number + 1) * np.array([1.0, 0, -1.0, 0]))
        outcome = bench.order(places[-1])
        bench.ticks(6)
        outcome.result(0)
    for place in places[3:0:-1]:
        outcome = bench.undo()
        bench.ticks(6)
        outcome.result(0)
        np.testing.assert_allclose(bench.machine.inside, place, atol=1e-12)
    assert bench.runner.hand.made == ()


def disturb(bench, what):
    machine = bench.machine
    if what in ("beam_lost", "current_unknown", "many_nan"):
        machine.script.append(what)
    elif what == "moved":
        machine.inside[2] += 3.0
    elif what == "write":
        machine.write_error = "refused"
    elif what == "not known":
        machine.setpoints_error = "no answer"
    elif what == "corrector":
        machine.readback_offset[0] = 5.0
    elif what == "worse":
        machine.disturbance = np.linspace(-80e-6, 80e-6, N)
    elif what == "fault":
        machine.script.append(RuntimeError("broken"))
    else:
        bench.runner.command(what)


TOLD = {
    "beam_lost": "current",
    "current_unknown": "current",
    "many_nan": "BPM",
    "moved": "setpoints are not where the last step left them: COR2",
    "write": "writing failed: refused",
    "not known": "do not follow their setpoint",
    "corrector": "COR0",
    "worse": "the orbit error grew to",
    "fault": "the loop has failed: RuntimeError: broken",
    "close": "the loop is CLOSED; setpoints are changed by hand while it is OPEN",
    "shadow": "the loop is SHADOW",
}


@pytest.mark.parametrize("what", TOLD)
def test_it_stops_at_once_if_anything_is_wrong_and_what_was_done_can_be_undone(what):
    bench = Bench()
    outcome = bench.order(np.zeros(M))
    bench.ticks(1)
    assert len(bench.machine.writes) == 1
    disturb(bench, what)
    bench.ticks(1)
    with pytest.raises(ControlError, match=r"^correction stopped after \d steps: ") as told:
        outcome.result(0)
    assert TOLD[what] in str(told.value)
    assert not bench.runner.hand.busy
    (made,) = bench.runner.hand.made
    np.testing.assert_array_equal(made.start, KICK)
    assert made.steps == 1 + (what == "write")


@pytest.mark.parametrize("what", sorted({*TOLD} - {"write", "worse", "fault", "moved"}))
def test_it_does_not_begin_where_the_loop_could_not_close(what):
    bench = Bench()
    disturb(bench, what)
    outcome = bench.order(np.zeros(M))
    bench.ticks(1)
    with pytest.raises(ControlError, match=r"^correction refused: ") as told:
        outcome.result(0)
    assert TOLD[what] in str(told.value)
    assert bench.runner.hand.made == ()
    assert what == "close" or bench.machine.writes == []


def test_it_does_not_begin_elsewhere_than_it_was_computed_for():
    bench = Bench()
    outcome = bench.order(np.zeros(M))
    bench.machine.inside[3] += 1.0
    bench.ticks(1)
    with pytest.raises(ControlError, match="setpoints are not those it was computed for: COR3"):
        outcome.result(0)
    assert bench.machine.writes == []


def test_a_corrector_that_was_disabled_meanwhile_is_not_moved():
    bench = Bench()
    bench.policy.movable = np.array([True, False, True, True])
    bench.ticks(1)
    outcome = bench.order(np.zeros(M))
    bench.ticks(1)
    with pytest.raises(ControlError, match=r"correction refused: the loop does not move COR1$"):
        outcome.result(0)
    outcome = bench.order(np.array([0.0, KICK[1], 0.0, 0.0]))
    bench.ticks(8)
    assert outcome.result(0).steps == 3
    assert not any(put[1] for put in bench.machine.put)


def test_what_somebody_moved_is_not_undone():
    bench = Bench()
    bench.order(np.zeros(M))
    bench.ticks(8)
    bench.machine.inside[2] += 1.0
    outcome = bench.undo()
    before = len(bench.machine.writes)
    bench.ticks(1)
    with pytest.raises(ControlError, match="setpoints are not those it was computed for: COR2"):
        outcome.result(0)
    assert len(bench.machine.writes) == before and len(bench.runner.hand.made) == 1


def test_an_undoing_that_stops_is_gone_on_with():
    bench = Bench()
    bench.order(np.zeros(M))
    bench.ticks(8)
    outcome = bench.undo()
    bench.ticks(1)
    bench.runner.command("shadow")
    bench.ticks(1)
    assert "stopped after 1 steps" in str(outcome.exception(0))
    bench.runner.command("open")
    bench.ticks(1)
    bench.undo()
    bench.ticks(8)
    np.testing.assert_allclose(bench.machine.inside, KICK, atol=1e-12)
    assert bench.runner.hand.made == ()


def test_an_orbit_that_is_missed_is_waited_for_but_not_long():
    bench = Bench()
    outcome = bench.order(np.zeros(M))
    bench.ticks(1)
    bench.machine.script.extend(["missing", "same_stamp"])
    bench.ticks(9)
    assert outcome.result(0).steps == 3
    outcome = bench.undo()
    bench.ticks(1)
    bench.machine.script.extend(["missing"] * 15)
    bench.ticks(16)
    assert "no orbit to act on came for" in str(outcome.exception(0))


def test_it_ends_where_a_limit_would_shorten_it():
    bench = Bench(setpoint=1.5)
    outcome = bench.order(np.array([1.2, -2.0, 0.0, 0.3]))
    bench.ticks(5)
    with pytest.raises(ControlError, match=r"stopped after 1 steps: 1 correctors at their limit"):
        outcome.result(0)
    assert np.abs(bench.machine.inside).max() <= 1.5


def test_one_at_a_time_and_none_after_the_end():
    bench = Bench()
    first = bench.order(np.zeros(M))
    with pytest.raises(ControlError, match="correction is under way"):
        bench.order(np.zeros(M), "another")
    assert first.cancel()
    bench.ticks(1)
    assert bench.machine.writes == [] and not bench.runner.hand.busy
    bench.machine.script.append(RuntimeError("broken"))
    bench.ticks(1)
    with pytest.raises(ControlError, match="refused: the loop has failed"):
        bench.order(np.zeros(M))
