"""One correction by hand: computed, refused with a reason, applied, undone."""

from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from orbitfb.app.commands.correct import Corrections
from orbitfb.app.commands.correction import Sources
from orbitfb.app.commands.preview import Latest
from orbitfb.core.clock import ManualClock
from orbitfb.core.errors import ControlError, OrbitFeedbackError
from orbitfb.core.signals import LoopState, Orbit, Reading
from orbitfb.loop.adjustments import Adjustments
from orbitfb.loop.correction.hand import Done
from orbitfb.loop.correction.move import Move
from orbitfb.loop.correction.settings import CorrectionSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.bounds import Bounds

CHANNELS = Ring.load().channels("x")
RESPONSE = response(Ring.load(), "x")
N, M = RESPONSE.shape
RANDOM = np.random.default_rng(3)
ORBIT = RESPONSE @ (0.05 * RANDOM.standard_normal(M))
START = 0.1 * RANDOM.standard_normal(M)


class Hands:
    """Carries every move out at once, or refuses it."""

    def __init__(self) -> None:
        self.made: tuple[Done, ...] = ()
        self.moves: list[Move] = []
        self.refusal = ""

    def order(self, move: Move, undoes: Done | None = None) -> Future[Done]:
        self.moves.append(move)
        outcome: Future[Done] = Future()
        if self.refusal:
            outcome.set_exception(ControlError(self.refusal))
            return outcome
        done = Done(move.name, move.start, move.aim, 1e-4, move.rms, 2)
        self.made = (*self.made, done) if undoes is None else self.made[:-1]
        outcome.set_result(done)
        return outcome


class Bench:
    def __init__(self, policy: Any = None, limit: float = 10.0) -> None:
        self.hand = Hands()
        self.clock = ManualClock(1e9)
        self.slot = PolicySlot(policy or SvdPolicy(RESPONSE, SvdSettings(gain=0.4)))
        self.runner = SimpleNamespace(
            state=LoopState.OPEN, hand=self.hand, adjustments=Adjustments.none(np.zeros(N), M)
        )
        self.latest, self.happened = Latest(), list[tuple[str, str]]()
        self.movable = np.ones(M, dtype=bool)
        sources = Sources(
            CHANNELS,
            cast(Any, self.runner),
            self.slot,
            self.latest,
            SvdSettings(),
            lambda: self.movable,
            lambda: Bounds.of(limit, M),
            CorrectionSettings(step=0.05),
            0.1,
        )
        statistics = SimpleNamespace(happened=lambda *words: self.happened.append(words))
        self.corrections = Corrections(sources, cast(Any, statistics), self.clock)
        self.see()

    def see(self, valid: Any = None, setpoints: Any = START) -> None:
        valid = np.ones(N, dtype=bool) if valid is None else valid
        reading = Reading(Orbit(ORBIT, valid, 0.0), setpoints, {}, self.clock.monotonic())
        record = SimpleNamespace(
            reading=reading, reference=np.zeros(N), setpoints=setpoints, applied=np.zeros(M)
        )
        self.latest(cast(Any, record))

    def __call__(self, command: str, **arguments: object) -> Any:
        return self.corrections.handlers[command]({"command": command, **arguments})


def test_the_baseline_corrects_all_of_it_and_the_preview_says_so():
    bench = Bench()
    answer = bench("correct")
    law = SvdPolicy(RESPONSE, SvdSettings(gain=1.0))
    change, _ = law.act(ORBIT, np.ones(N, dtype=bool), law.initial_state())
    after = ORBIT + RESPONSE @ change
    assert answer["law"] == law.policy_id
    assert answer["rms_change_A"] == pytest.approx(np.sqrt(np.mean(change**2)))
    assert answer["largest_change_A"] == pytest.approx(np.abs(change).max())
    assert answer["largest_at"] == CHANNELS.correctors[int(np.abs(change).argmax())]
    assert answer["steps"] == np.ceil(np.abs(change).max() / 0.05)
    assert answer["orbit_rms_um"] == pytest.approx(np.sqrt(np.mean(ORBIT**2)) * 1e6)
    assert answer["predicted_rms_um"] == pytest.approx(np.sqrt(np.mean(after**2)) * 1e6)
    assert bench.hand.moves == []
    shown = bench.corrections.shown()
    np.testing.assert_allclose(shown["PreviewX-I"], change, atol=1e-7)
    assert shown["CorrectOrbit-I"] == answer["predicted_rms_um"] and shown["Undos-I"] == 0
    done = bench("correct-apply")
    (move,) = bench.hand.moves
    np.testing.assert_allclose(move.aim, START + change)
    np.testing.assert_array_equal(move.start, START)
    assert (done["steps"], done["can_be_undone"]) == (2, 1)
    kind, words = bench.happened[-1]
    assert kind == "correction" and "done in 2 steps: 100 to" in words
    shown = bench.corrections.shown()
    assert shown["CorrectText-I"] == words and shown["PreviewX-I"] is None
    with pytest.raises(ControlError, match="no correction was computed since the last one"):
        bench("correct-apply")


def test_the_policy_in_force_asks_for_what_it_would_at_its_first_tick():
    bench = Bench()
    bench("correct", law="active", once=True)
    policy = bench.slot.acting
    change, _ = policy.act(ORBIT, np.ones(N, dtype=bool), policy.initial_state())
    np.testing.assert_allclose(bench.hand.moves[0].aim, START + change)


def test_bpms_and_correctors_that_are_out_of_use_have_no_part():
    bench = Bench()
    valid = np.ones(N, dtype=bool)
    valid[5], bench.movable[7] = False, False
    bench.see(valid)
    bench("correct", once=True)
    change = bench.hand.moves[0].aim - START
    assert change[7] == 0.0
    rest = (ORBIT + RESPONSE @ change)[valid]
    assert np.sqrt(np.mean(rest**2)) < 0.05 * np.sqrt(np.mean(ORBIT**2))


def test_a_corrector_that_would_go_beyond_its_limit_stays_and_the_others_take_its_part():
    free = Bench()
    free.see(setpoints=np.zeros(M))
    free("correct", once=True)
    aim = free.hand.moves[0].aim
    first = int(np.abs(aim).argmax())
    start = np.zeros(M)
    start[first] = np.sign(aim[first]) * (10.0 - 0.5 * abs(aim[first]))
    bench = Bench(limit=10.0)
    bench.see(setpoints=start)
    answer = bench("correct", once=True)
    assert answer["left_out"] == CHANNELS.correctors[first]
    move = bench.hand.moves[0]
    assert move.aim[first] == start[first] and np.abs(move.aim).max() <= 10.0
    assert move.rms < 0.1 * np.sqrt(np.mean(ORBIT**2))


def test_it_is_undone_from_where_it_was_left_to_where_it_began():
    bench = Bench()
    bench("correct", once=True)
    made = bench.hand.made[0]
    answer = bench("undo")
    move = bench.hand.moves[1]
    assert move.start is made.left and move.aim is made.start
    assert answer["done"] == f"undo of {made.name}" and answer["can_be_undone"] == 0
    back = np.sqrt(np.mean((ORBIT - RESPONSE @ (made.left - made.start)) ** 2))
    assert move.rms == pytest.approx(back)
    with pytest.raises(ControlError, match="nothing to undo"):
        bench("undo")


@pytest.mark.parametrize("state", [LoopState.CLOSED, LoopState.HELD, LoopState.SHADOW])
def test_only_an_open_loop_is_corrected_by_hand(state: LoopState):
    bench = Bench()
    bench("correct", once=True)
    bench.runner.state = state
    for command in ("correct", "undo"):
        with pytest.raises(ControlError, match=f"{command} refused: the loop is {state}; `open`"):
            bench(command)
    bench.runner.state = LoopState.TRIPPED
    with pytest.raises(ControlError, match="`reset` it first"):
        bench("correct")


def test_an_old_preview_is_not_applied():
    bench = Bench()
    bench("correct")
    bench.clock.advance(61.0)
    with pytest.raises(ControlError, match=r"computed 61 s ago, longer than 60 s"):
        bench("correct-apply")


def test_a_preview_for_another_reference_is_not_applied():
    bench = Bench()
    bench("correct")
    bench.runner.adjustments = Adjustments.none(1e-5 * np.ones(N), M)
    with pytest.raises(ControlError, match="devices in use were changed since it was computed"):
        bench("correct-apply")
    assert bench.hand.moves == []


def test_what_the_loop_refuses_is_told_and_shown():
    bench = Bench()
    bench.hand.refusal = "correction refused: no beam"
    bench("correct")
    with pytest.raises(ControlError, match="no beam"):
        bench("correct-apply")
    assert bench.corrections.shown()["CorrectText-I"] == "correction refused: no beam"
    assert bench.happened == [("correction", "correction refused: no beam")]


class Policy:
    policy_id, response = "odd", RESPONSE

    def __init__(self, change: Any) -> None:
        self._change = change

    def initial_state(self) -> None:
        return None

    def act(self, error: Any, valid: Any, state: None) -> Any:
        return self._change, state


def test_what_makes_no_sense_is_refused_before_anything_moves():
    bench = Bench(Policy(np.full(M, np.nan)))
    with pytest.raises(OrbitFeedbackError, match="changes that are not finite"):
        bench("correct", law="active")
    with pytest.raises(ControlError, match=r"refused: the orbit error is .* and would be"):
        Bench(Policy(np.ones(M)))("correct", law="active")
    for arguments, words in (
        ({"law": "best"}, "law must be baseline or active, not 'best'"),
        ({"once": 1}, "once must be true or false, not 1"),
    ):
        with pytest.raises(ControlError, match=words):
            bench("correct", **arguments)
    bench.see(np.zeros(N, dtype=bool))
    with pytest.raises(ControlError, match="no BPM of the last orbit counts"):
        bench("correct")
    bench.see(setpoints=np.full(M, np.nan))
    with pytest.raises(ControlError, match="the setpoints in force are not known"):
        bench("correct")
    bench.see()
    bench.clock.advance(3.0)
    with pytest.raises(ControlError, match="the last orbit came 3 s ago"):
        bench("correct")
    with pytest.raises(ControlError, match="no orbit has come yet"):
        bench.latest.record = None
        bench("correct")
    assert bench.hand.moves == []
