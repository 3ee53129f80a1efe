"""The runner on a scripted ring: one test per rule."""

import threading
from dataclasses import replace

import numpy as np
import pytest
from scripted import (
    PERIOD,
    RESPONSE,
    ConstantPolicy,
    InversePolicy,
    M,
    N,
    ScriptedMachine,
    new_clock,
)

from orbitfb.core.errors import ConfigError, ConnectError, ControlError
from orbitfb.core.signals import LoopState
from orbitfb.history.buffer import History
from orbitfb.loop.commands import ORBIT_TO_CLOSE_ON
from orbitfb.loop.excitation.dither import Dither, DitherSettings
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings

PATIENT = {"divergence_ticks": 1000}  # for policies that drive the orbit away on purpose


class Bench:
    def __init__(self, policy=None, start=LoopState.OPEN, dither=None, interlocks=None, **loop):
        self.clock = new_clock()
        self.machine = ScriptedMachine(self.clock)
        self.slot = PolicySlot(policy or InversePolicy())
        self.records = []
        self.runner = Runner(
            self.machine,
            self.slot,
            LoopSettings(**{"ramp": 0.0, **loop}),
            LimitSettings(),
            InterlockSettings(**{"max_invalid_bpms": 2, "bpm_proving": 1} | (interlocks or {})),
            np.zeros(N),
            self.clock,
            dither,
            start,
            (self.records.append,),
        )

    def step(self, *events):
        """One tick per event (one good one if there are none); the last record."""
        self.machine.script.extend(events or ("good",))
        return [self.runner.step() for _ in events or ("good",)][-1]

    def close(self):
        future = self.runner.command("close")
        self.step()
        assert future.result(timeout=0) is LoopState.CLOSED
        return self


def test_open_reads_and_writes_nothing():
    bench = Bench()
    record = bench.step()
    assert record.state is LoopState.OPEN
    assert record.reading is not None
    assert bench.machine.writes == []
    assert not record.requested.any()
    np.testing.assert_array_equal(record.setpoints, bench.machine.inside)


def test_shadow_decides_and_never_writes():
    bench = Bench(start=LoopState.SHADOW)
    bench.machine.disturbance[:] = 50e-6
    record = bench.step()
    assert record.requested.any()
    assert not record.applied.any()
    assert np.isnan(record.written)
    assert bench.machine.writes == []


def test_closing_takes_the_orbit_down_and_opening_leaves_the_setpoints():
    bench = Bench()
    bench.machine.disturbance = RESPONSE @ np.array([1.0, -1.0, 0.5, 0.2])
    bench.close()
    record = bench.step(*["good"] * 20)
    assert np.sqrt(np.mean(record.reading.orbit.position**2)) < 1e-6
    np.testing.assert_allclose(record.applied, record.scale * record.requested, atol=1e-12)
    inside, count = bench.machine.inside.copy(), len(bench.machine.writes)
    bench.runner.command("open")
    assert bench.step("good", "good").state is LoopState.OPEN
    np.testing.assert_array_equal(bench.machine.inside, inside)
    assert len(bench.machine.writes) == count


def test_the_gain_ramps_after_closing():
    bench = Bench(ConstantPolicy([0.1] * M), ramp=0.5, interlocks=PATIENT).close()
    for _ in range(6):
        bench.step()
    gains = [record.requested[0] / 0.1 for record in bench.records]
    np.testing.assert_allclose(gains, [0.2, 0.4, 0.6, 0.8, 1.0, 1.0, 1.0], rtol=1e-6)


def test_an_orbit_that_does_not_come_holds_within_two_periods_and_nothing_is_written():
    bench = Bench().close()
    before, count = bench.clock.monotonic(), len(bench.machine.writes)
    record = bench.step("missing")
    assert record.state is LoopState.HELD
    assert record.reading is None
    assert "script" in record.reason
    assert bench.clock.monotonic() - before <= 2 * PERIOD
    assert len(bench.machine.writes) == count


def test_a_held_loop_rereads_the_setpoints_and_closes_by_itself_without_a_bump():
    bench = Bench(proving=3).close()
    bench.step("missing")
    bench.machine.inside = np.array([0.5, 0.0, -0.5, 1.0])  # a restarted server has others
    moved = bench.machine.inside.copy()
    count = len(bench.machine.writes)
    assert bench.step("good", "good").state is LoopState.HELD
    assert len(bench.machine.writes) == count
    record = bench.step()
    assert record.state is LoopState.CLOSED
    np.testing.assert_array_equal(record.setpoints, moved)
    np.testing.assert_allclose(bench.machine.writes[-1], moved + record.applied)


def test_bad_orbits_start_the_proving_again():
    bench = Bench(proving=3).close()
    record = bench.step("missing", "good", "good", "many_nan", "good", "good")
    assert record.state is LoopState.HELD
    assert bench.step().state is LoopState.CLOSED


def test_without_reclose_the_loop_waits_for_the_command():
    bench = Bench(reclose=False).close()
    assert bench.step("missing", *["good"] * 10).state is LoopState.HELD
    bench.close()


def test_held_too_long_trips_and_only_reset_leads_out():
    bench = Bench(trip_after=1.0).close()
    assert bench.step(*["missing"] * 3).state is LoopState.HELD
    record = bench.step(*["missing"] * 10)
    assert record.state is LoopState.TRIPPED
    assert "held for" in record.reason
    assert bench.step(*["good"] * 10).state is LoopState.TRIPPED
    for name in ("open", "shadow", "close"):
        with pytest.raises(ControlError, match="reset first"):
            bench.runner.command(name)
    bench.runner.command("reset")
    assert bench.step().state is LoopState.OPEN


@pytest.mark.parametrize(
    ("event", "state", "reason"),
    [
        ("beam_lost", LoopState.TRIPPED, "stored current"),
        ("current_unknown", LoopState.TRIPPED, "not known"),
        ("many_nan", LoopState.HELD, "BPM0, BPM1"),
        ("one_nan", LoopState.CLOSED, "BPM0"),
        ("same_stamp", LoopState.CLOSED, "stamp"),
        ("frozen", LoopState.CLOSED, "readings"),
    ],
)
def test_what_an_orbit_does_to_a_closed_loop(event, state, reason):
    bench = Bench().close()
    bench.step()
    count = len(bench.machine.writes)
    record = bench.step(event)
    assert record.state is state
    assert reason in record.reason
    assert len(bench.machine.writes) - count == (1 if event == "one_nan" else 0)


def test_a_frozen_orbit_is_not_integrated():
    bench = Bench().close()
    count = len(bench.machine.writes)
    assert bench.step("frozen", "frozen").state is LoopState.HELD
    assert len(bench.machine.writes) == count


def test_an_unknown_current_delays_the_return_but_does_not_latch():
    bench = Bench().close()
    assert bench.step("missing", "current_unknown").state is LoopState.HELD
    assert bench.step("good", "good", "good").state is LoopState.CLOSED
    assert bench.step("missing", "beam_lost").state is LoopState.TRIPPED


def test_closing_on_a_bad_orbit_is_refused_with_the_reason():
    bench = Bench()
    future = bench.runner.command("close")
    assert bench.step("beam_lost").state is LoopState.OPEN
    with pytest.raises(ControlError, match=r"close refused: .*stored current"):
        future.result(timeout=0)
    bench.machine.setpoints_error = "no answer from COR2"
    future = bench.runner.command("close")
    bench.step()
    with pytest.raises(ControlError, match="COR2"):
        future.result(timeout=0)


def test_an_order_to_close_waits_for_an_orbit_but_not_for_ever():
    bench = Bench()
    future = bench.runner.command("close")
    assert bench.step("missing", "missing").state is LoopState.OPEN
    assert not future.done()
    assert bench.step("good").state is future.result(timeout=0) is LoopState.CLOSED
    bench.runner.command("open")
    bench.step()
    future, given = bench.runner.command("close"), bench.clock.monotonic()
    while not future.done():
        assert bench.step("missing").state is LoopState.OPEN
    with pytest.raises(ControlError, match=r"close refused: .*script"):
        future.result(timeout=0)
    assert bench.clock.monotonic() - given == pytest.approx(ORBIT_TO_CLOSE_ON, abs=2 * 1.9 * PERIOD)


def test_an_order_to_close_ends_with_the_trip_that_comes_while_it_waits():
    bench = Bench(trip_after=1.0).close()
    assert bench.step("missing", "missing", "missing").state is LoopState.HELD
    future = bench.runner.command("close")
    while bench.step("missing").state is LoopState.HELD:
        assert not future.done()
    with pytest.raises(ControlError, match=r"close refused: .*script"):
        future.result(timeout=0)
    assert bench.step("good").state is LoopState.TRIPPED


def test_a_failed_write_holds_and_what_is_in_force_is_asked_for():
    bench = Bench(ConstantPolicy([0.5] * M), proving=1).close()
    before = bench.machine.inside.copy()
    bench.machine.write_error = "COR3 is away"
    record = bench.step()
    assert record.state is LoopState.HELD
    assert "COR3" in record.reason
    assert not record.applied.any()
    bench.machine.write_error = None
    record = bench.step()
    assert record.state is LoopState.CLOSED
    np.testing.assert_array_equal(record.setpoints, before + np.array([0.5, 0, 0, 0]))


def test_an_operator_who_moves_a_corrector_is_not_fought():
    bench = Bench(ConstantPolicy(np.zeros(M)), proving=2).close()
    bench.machine.inside[1] += 3.0
    count = len(bench.machine.writes)
    record = bench.step()
    assert record.state is LoopState.HELD
    assert "somebody else: COR1" in record.reason
    assert bench.step("good").state is LoopState.HELD
    assert len(bench.machine.writes) == count
    assert bench.step("good").state is LoopState.CLOSED
    assert bench.machine.writes[-1][1] == 3.0


def test_a_corrector_that_does_not_follow_holds_after_some_ticks():
    bench = Bench(ConstantPolicy(np.zeros(M)), interlocks={"readback_ticks": 3}).close()
    bench.machine.readback_offset[2] = 1.0
    assert bench.step("good", "good").state is LoopState.CLOSED
    record = bench.step()
    assert record.state is LoopState.HELD
    assert "COR2" in record.reason
    assert bench.step(*["good"] * 10).state is LoopState.HELD
    bench.machine.readback_offset[2] = np.nan
    assert bench.step(*["good"] * 10).state is LoopState.HELD
    bench.machine.readback_offset[2] = 0.0
    assert bench.step(*["good"] * 3).state is LoopState.CLOSED


def test_a_wrong_sign_trips_on_divergence():
    policy = InversePolicy(gain=-0.4)
    bench = Bench(policy)
    bench.machine.disturbance = RESPONSE @ np.array([1.0, -1.0, 0.5, 0.2])
    bench.close()
    record = bench.step(*["good"] * 12)
    assert record.state is LoopState.TRIPPED
    assert "grew" in record.reason


def test_a_policy_that_raises_is_a_fault_and_writes_nothing():
    bench = Bench(ConstantPolicy([]), start=LoopState.SHADOW)
    pending = bench.runner.command("close")
    record = bench.step()
    assert record.state is LoopState.FAULT
    assert "RuntimeError: no idea" in record.reason
    assert isinstance(bench.runner.failure, RuntimeError)
    assert pending.result(timeout=0) is LoopState.CLOSED
    assert bench.machine.writes == []
    reads = len(bench.machine.reads)
    assert bench.step().state is LoopState.FAULT
    assert len(bench.machine.reads) == reads
    with pytest.raises(ControlError, match="start it again"):
        bench.runner.command("reset")
    bench.runner.run(threading.Event())  # returns at once


def test_a_policy_of_the_wrong_shape_is_a_fault():
    bench = Bench(ConstantPolicy([1.0]), start=LoopState.SHADOW)
    assert bench.step().state is LoopState.FAULT


def test_a_policy_that_is_not_finite_trips_and_writes_nothing():
    bench = Bench(ConstantPolicy([0.0, np.nan, 0.0, 0.0]))
    bench.runner.command("close")
    record = bench.step()
    assert record.state is LoopState.TRIPPED
    assert "policy constant" in record.reason
    assert "COR1" in record.reason
    assert bench.machine.writes == []
    assert np.isfinite(record.requested).all()


def test_a_corrector_at_its_limit_is_said():
    bench = Bench(ConstantPolicy([2.0, 0, 0, 0]), interlocks=PATIENT).close()
    record = bench.step(*["good"] * 12)
    assert record.state is LoopState.CLOSED
    assert record.scale == 0.0
    assert "COR0" in record.reason
    assert np.abs(bench.machine.writes).max() <= 17.5


def test_a_swap_takes_effect_at_the_next_tick_and_starts_the_new_policy_afresh():
    bench = Bench().close()
    other = InversePolicy("other")
    bench.machine.on_read = lambda: bench.slot.swap(other) if bench.slot.swaps == 0 else None
    record = bench.step()
    assert record.policy_id == "other"
    assert record.state is LoopState.CLOSED
    assert other.started == 1
    assert bench.slot.swaps == 1
    assert record.missed == 0


def test_a_command_given_during_the_wait_counts_for_the_orbit_that_comes():
    bench = Bench().close()
    count = len(bench.machine.writes)
    bench.machine.on_read = lambda: bench.runner.command("open")
    assert bench.step().state is LoopState.OPEN
    assert len(bench.machine.writes) == count


def test_a_close_that_is_followed_by_open_is_refused():
    bench = Bench()
    close, opened = bench.runner.command("close"), bench.runner.command("open")
    assert bench.step().state is LoopState.OPEN
    assert opened.result(timeout=0) is LoopState.OPEN
    with pytest.raises(ControlError, match="open came right after"):
        close.result(timeout=0)


def test_start_closed_proves_first_and_starts_without_a_bump():
    bench = Bench(start=LoopState.CLOSED, proving=3)
    bench.machine.inside[:] = 4.0
    bench.machine.disturbance = -RESPONSE @ bench.machine.inside
    assert bench.step("good", "good").state is LoopState.HELD
    assert bench.step().state is LoopState.CLOSED
    np.testing.assert_allclose(bench.machine.writes[0], 4.0, atol=0.05)


def test_subscribers_that_raise_do_not_stop_the_loop():
    bench = Bench()
    seen = []

    def broken(record):
        raise ValueError("full")

    runner = Runner(
        bench.machine, bench.slot, LoopSettings(), LimitSettings(), InterlockSettings(),
        np.zeros(N), bench.clock, subscribers=(broken, seen.append),
    )  # fmt: skip
    runner.step()
    runner.step()
    assert [record.tick for record in seen] == [0, 1]
    assert runner.subscriber_failures == 2
    assert "full" in runner.last_subscriber_failure


def test_missed_orbits_are_counted():
    bench = Bench().close()
    bench.step("missing", "missing", "good")
    assert [record.missed for record in bench.records] == [0, 1, 2, 1]  # 2 × 0.19 + 0.1 s


def test_the_dither_is_logged_by_itself_and_scaled_with_the_change():
    dither = Dither(DitherSettings(orbit_cost=1e-6), RESPONSE)
    bench = Bench(ConstantPolicy(np.zeros(M)), dither=dither).close()
    total = sum(record.scale * record.dither for record in bench.records)
    for _ in range(5):
        record = bench.step()
        np.testing.assert_array_equal(record.requested, record.dither)
        total = total + record.scale * record.dither
    np.testing.assert_allclose(dither.excursion, total)
    np.testing.assert_allclose(bench.machine.inside, total)
    assert total.any()


def test_an_orbit_that_got_old_is_not_acted_on():
    class Slow(InversePolicy):
        def act(self, error, valid, state):
            bench.clock.advance(1.0)
            return super().act(error, valid, state)

    bench = Bench(Slow())
    bench.runner.command("close")
    record = bench.step()
    assert record.state is LoopState.HELD
    assert "old" in record.reason
    assert bench.machine.writes == []


def test_run_returns_when_told_and_refuses_what_comes_later():
    bench = Bench()
    stop = threading.Event()
    bench.machine.on_read = lambda: stop.set() if len(bench.machine.reads) == 3 else None
    bench.runner.run(stop)
    assert len(bench.records) == 4
    with pytest.raises(ControlError, match="ended"):
        bench.runner.command("close")


def test_a_machine_that_fails_at_once_does_not_make_the_loop_spin():
    bench = Bench(rate_hz=100.0)
    stop, waited = threading.Event(), []

    class Stop(threading.Event):
        def wait(self, timeout=None):
            waited.append(timeout)
            if len(waited) == 2:
                stop.set()
                self.set()
            return True

    error = ConnectError(["A"], 1, 0.0, "look")
    bench.machine.script.extend([error] * 9)
    bench.runner.run(Stop())
    assert waited == [pytest.approx(0.005)] * 2


def test_the_fit_of_reference_and_start_is_checked():
    bench = Bench()
    common = (LoopSettings(), LimitSettings(), InterlockSettings())
    for reference in (np.zeros(N + 1), np.full(N, np.nan)):
        with pytest.raises(ConfigError, match="reference"):
            Runner(bench.machine, bench.slot, *common, reference, bench.clock)
    with pytest.raises(ConfigError, match="start"):
        Runner(bench.machine, bench.slot, *common, np.zeros(N), bench.clock, start=LoopState.HELD)


def test_what_no_readback_tells_is_still_reread_before_a_held_loop_writes():
    bench = Bench(ConstantPolicy(np.zeros(M)), proving=2).close()
    bench.step("missing", "good")
    bench.machine.inside[3] += 0.05  # less than the tolerance of the readback
    assert bench.step().state is LoopState.CLOSED
    assert bench.machine.writes[-1][3] == 0.05


def test_beside_a_fast_feedback_that_is_closed_nothing_is_written():
    bench = Bench(interlocks={"fast_feedback_channel": "fofb"})
    read, status = bench.machine.read, {"fofb": 1.0}

    def reading(timeout):
        its = read(timeout)
        return replace(its, auxiliary={**its.auxiliary, **status})

    bench.machine.read = reading
    refused = bench.runner.command("close")
    assert bench.step().state is LoopState.OPEN
    with pytest.raises(ControlError, match=r"the fast feedback is closed \(fofb is 1\)"):
        refused.result(timeout=0)
    status["fofb"] = 0.0
    bench.close()
    bench.step("good", "good")
    written = len(bench.machine.writes)
    for told, words in ((1.0, "is closed"), (np.nan, "is not known")):
        status["fofb"] = told
        assert bench.step("good", "good").state is LoopState.HELD
        assert words in bench.records[-1].reason
    assert written == len(bench.machine.writes)
    status["fofb"] = 0.0
    assert bench.step(*["good"] * 5).state is LoopState.CLOSED


def test_ticks_in_which_a_fast_feedback_was_closed_do_not_teach():
    bench = Bench(interlocks={"fast_feedback_channel": "fofb"})
    read, status = bench.machine.read, iter([1.0] * 3 + [0.0] * 3 + [np.nan] * 2 + [0.0] * 3)

    def reading(timeout):
        its = read(timeout)
        return replace(its, auxiliary={**its.auxiliary, "fofb": next(status)})

    bench.machine.read = reading
    history = History(bench.machine.channels, 100)
    bench.runner.subscribe(history)
    bench.step(*["good"] * 11)
    rows = history.snapshot()
    assert rows.usable.tolist() == [False] * 3 + [True] * 2 + [False] * 3 + [True] * 2
