"""The machine of an open loop lent to another thread: served at ticks, called back, put back."""

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scripted import RESPONSE, InversePolicy, M, N, ScriptedMachine, new_clock

from orbitfb.core.errors import AwayError, ControlError, MachineError, NoOrbitError, WriteError
from orbitfb.core.signals import LoopState
from orbitfb.loop.correction.move import Move
from orbitfb.loop.correction.settings import CorrectionSettings
from orbitfb.loop.lending.lent import LentMachine
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings

BASE = np.array([0.3, -0.2, 0.0, 0.1])
ALL = np.ones(M, dtype=bool)
NAME = "measurement"


class Bench:
    """An open loop, and a procedure that borrows its machine."""

    def __init__(self, setpoint: float = 5.0) -> None:
        self.machine: Any = ScriptedMachine(new_clock())
        self.machine.inside = BASE.copy()
        self.policy: Any = InversePolicy()
        self.runner = Runner(
            self.machine,
            PolicySlot(self.policy),
            LoopSettings(ramp=0.0, proving=2),
            LimitSettings(setpoint=setpoint, change_per_tick=1.0),
            InterlockSettings(bpm_proving=1, bpm_jump=1.0, distortion_rms=3e-4),
            np.zeros(N),
            self.machine.clock,
            correction=CorrectionSettings(step=0.5),
        )
        self.steps(3)
        self.records: list[Any] = []

    def steps(self, count: int) -> Any:
        return [self.runner.step() for _ in range(count)][-1]

    def borrow(self, work: Callable[[LentMachine], Any], which: Any = ALL) -> "Borrower":
        return Borrower(self, self.runner.lend(NAME, which), work)


class Borrower(threading.Thread):
    """Runs a procedure in its own thread while the test ticks the loop."""

    def __init__(self, bench: Bench, lent: LentMachine, work: Callable[[LentMachine], Any]) -> None:
        super().__init__(daemon=True)
        self.bench, self.lent, self.work = bench, lent, work
        self.result: Any = None
        self.error: Exception | None = None
        self.start()

    def run(self) -> None:
        try:
            self.result = self.work(self.lent)
        except Exception as error:
            self.error = error
        finally:
            self.lent.close()

    def finish(self) -> Any:
        for _ in range(400):
            self.bench.records.append(self.bench.runner.step())
            if not self.is_alive():
                break
        self.join(10.0)
        assert not self.is_alive()
        return self.result


def there_and_back(lent: LentMachine) -> Any:
    """Move a corrector, look, put it back whatever happens."""
    base = lent.setpoints()
    away = base + np.array([0.5, 0.0, 0.0, 0.0])
    one = np.array([True, False, False, False])
    lent.read(1.0)
    try:
        lent.write(away, one)
        return [lent.read(1.0).orbit.position for _ in range(10)]
    finally:
        lent.write(base, one)


def test_a_borrower_reads_asks_and_writes_and_the_records_tell_it():
    bench = Bench()
    orbits = bench.borrow(there_and_back).finish()
    assert len(orbits) == 10
    np.testing.assert_allclose(orbits[-1], RESPONSE @ (BASE + np.array([0.5, 0, 0, 0])), atol=2e-6)
    np.testing.assert_array_equal(bench.machine.inside, BASE)
    moved = [record.applied[0] for record in bench.records if record.applied.any()]
    assert moved == pytest.approx([0.5, -0.5])
    assert {record.state for record in bench.records} == {LoopState.OPEN}
    assert bench.records[0].reason == "measurement is under way"
    assert bench.steps(1).reason == ""
    assert all(put.tolist() == [True, False, False, False] for put in bench.machine.put)
    assert not bench.runner.lending.busy


def test_no_corrector_is_put_twice_between_two_orbits_but_others_are():
    bench = Bench()
    one, other = np.array([True, False, False, False]), np.array([False, True, False, False])

    def work(lent: LentMachine) -> None:
        lent.read(1.0)
        for step in (0.1, 0.2):
            lent.write(BASE + step, one)
            lent.write(BASE + step, other)

    bench.borrow(work).finish()
    applied = [record.applied[:2].tolist() for record in bench.records if record.applied.any()]
    np.testing.assert_allclose(applied, [[0.1, 0.1], [0.1, 0.1]])
    np.testing.assert_allclose(bench.steps(1).setpoints, BASE + np.array([0.2, 0.2, 0, 0]))


BAD = {
    "limit": (BASE + np.array([6.0, 0, 0, 0]), ALL, "a setpoint may change by 1 A in a tick"),
    "far": (np.array([0.3, -0.2, 0.0, 0.1 + 5.0]), ALL, "nothing was sent"),
    "nan": (np.full(M, np.nan), ALL, "not finite"),
    "not lent": (BASE, ALL, "not lent"),
}


@pytest.mark.parametrize("what", BAD)
def test_a_write_beyond_a_limit_or_of_another_corrector_is_not_sent(what: str):
    bench = Bench()
    setpoints, which, told = BAD[what]
    lent = np.array([True, True, True, what != "not lent"])

    def work(machine: LentMachine) -> None:
        machine.read(1.0)
        machine.write(setpoints, which)

    borrower = bench.borrow(work, lent)
    borrower.finish()
    assert isinstance(borrower.error, WriteError) and told in str(borrower.error)
    assert bench.machine.writes == []


def test_drive_limits_of_the_moment_hold():
    bench = Bench()
    bench.machine.inside[0] = 4.9
    borrower = bench.borrow(lambda lent: (lent.read(1.0), lent.write(lent.setpoints() + 0.2)))
    borrower.finish()
    assert isinstance(borrower.error, WriteError) and "at their limit" in str(borrower.error)
    assert bench.machine.writes == []


@pytest.mark.parametrize("command", ["close", "shadow"])
def test_a_loop_whose_machine_is_lent_stays_open(command: str):
    bench = Bench()
    gate = threading.Event()

    def work(lent: LentMachine) -> None:
        lent.read(1.0)
        gate.wait(10.0)

    borrower = bench.borrow(work)
    told = rf"{command} refused: measurement is under way; abort it first"
    with pytest.raises(ControlError, match=told):
        bench.runner.command(command)
    assert bench.runner.command("open").cancel() is True
    with pytest.raises(ControlError, match="correction refused: measurement is under way"):
        bench.runner.hand.order(Move("correction", BASE, BASE, 0.0))
    with pytest.raises(ControlError, match="measurement refused: measurement is under way"):
        bench.runner.lend(NAME, ALL)
    gate.set()
    borrower.finish()
    future = bench.runner.command(command)
    bench.steps(3)
    assert future.result(0) is not LoopState.OPEN


def test_an_order_to_close_that_came_just_before_is_refused():
    bench = Bench()
    future = bench.runner.command("close")
    borrower = bench.borrow(there_and_back)
    bench.steps(1)
    with pytest.raises(ControlError, match="close refused: measurement is under way"):
        future.result(0)
    borrower.finish()
    assert borrower.error is None and bench.runner.state is LoopState.OPEN


def test_it_is_not_lent_while_the_loop_is_not_open_or_a_correction_is_made():
    bench = Bench()
    bench.runner.command("shadow")
    bench.steps(1)
    with pytest.raises(ControlError, match=r"refused: the loop is SHADOW; `open` it first"):
        bench.runner.lend(NAME, ALL)
    bench.runner.command("open")
    bench.steps(1)
    bench.runner.hand.order(Move("correction", BASE, 0 * BASE, 0.0))
    with pytest.raises(ControlError, match="measurement refused: correction is under way"):
        bench.runner.lend(NAME, ALL)


def spoil(bench: Bench, what: str) -> None:
    machine = bench.machine
    if what in ("beam_lost", "many_nan"):
        machine.script.append(what)
    elif what == "corrector":
        machine.readback_offset[0] = 5.0
    elif what == "disabled":
        bench.policy.movable = np.array([True, False, True, True])
    elif what == "missing":
        machine.script.extend(["missing"] * 40)
    elif what == "fault":
        machine.script.append(RuntimeError("broken"))
    elif what == "end":
        bench.runner.run(stopped())


def stopped() -> threading.Event:
    stop = threading.Event()
    stop.set()
    return stop


CALLED_BACK = {
    "beam_lost": "current",
    "many_nan": "BPM",
    "corrector": "COR0",
    "disabled": "the loop does not move COR1",
    "missing": "no orbit to act on came for",
    "fault": "the loop has failed: RuntimeError: broken",
    "end": "the loop has ended in OPEN",
}


@pytest.mark.parametrize("what", CALLED_BACK)
def test_whatever_is_wrong_calls_the_machine_back_once_and_all_is_put_back(what: str):
    bench = Bench()
    told: list[str] = []
    moved = threading.Event()

    def work(lent: LentMachine) -> None:
        base = lent.setpoints()
        one = np.array([True, False, False, False])
        lent.write(base + np.array([0.5, 0, 0, 0]), one)
        moved.set()
        try:
            while True:
                try:
                    lent.read(1.0)
                except NoOrbitError:
                    continue
                except MachineError as error:
                    told.append(str(error))
                    break
        finally:
            lent.write(base, one)

    borrower = bench.borrow(work)
    while not moved.is_set():
        bench.steps(1)
    bench.steps(1)
    spoil(bench, what)
    borrower.finish()
    assert CALLED_BACK[what] in told[0] and borrower.error is None
    np.testing.assert_array_equal(bench.machine.inside, BASE)
    assert not bench.runner.lending.busy


def test_a_failed_write_is_the_borrowers_and_the_loop_asks_anew_what_is_in_force():
    bench = Bench()
    bench.machine.write_error = "refused"
    borrower = bench.borrow(lambda lent: lent.write(BASE + 0.5))
    borrower.finish()
    assert isinstance(borrower.error, WriteError) and str(borrower.error) == "refused"
    record = bench.steps(1)
    np.testing.assert_allclose(record.setpoints, BASE + np.array([0.5, 0, 0, 0]))  # one had left


def test_errors_of_the_machine_reach_the_borrower_whole():
    bench = Bench()
    away = AwayError("COR1 is away", BASE, np.array([False, True, False, False]))

    def setpoints() -> Any:
        raise away

    def work(lent: LentMachine) -> None:
        bench.machine.setpoints = setpoints
        lent.setpoints()

    borrower = bench.borrow(work)
    borrower.finish()
    assert borrower.error is away


def test_a_loop_that_ends_does_not_wait_for_ever_for_one_that_says_nothing(
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.setattr("orbitfb.loop.lending.desk.SPEECHLESS", 1.0)
    bench = Bench()
    gate = threading.Event()
    borrower = bench.borrow(lambda lent: gate.wait(10.0))
    bench.steps(1)
    bench.runner.run(stopped())
    assert not bench.runner.lending.busy
    gate.set()
    with pytest.raises(ControlError, match="refused: the loop has ended"):
        bench.runner.lend(NAME, ALL)
    assert borrower.error is None
