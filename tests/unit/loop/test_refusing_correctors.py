"""One corrector whose puts do not stay neither stops nor misleads the loop."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scripted import PERIOD, RESPONSE, M, N, ScriptedMachine, new_clock

from orbitfb.core.signals import LoopState
from orbitfb.loop.guard import Safeguards
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.policies.masking import without
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings

BAD = 2


class Refusing(ScriptedMachine):
    """Corrector 2 does with its puts what it is told."""

    def __init__(self, clock):
        super().__init__(clock, seed=3)
        self.kind, self.heard = "", {}
        self.drive = np.full((M, 2), np.nan)

    def read(self, timeout):
        if self.kind == "link":
            self.inside[BAD] = 0.02
        reading = super().read(timeout)
        heard, self.heard = self.heard, {}
        away = None
        if self.kind == "rights":
            away, heard = np.arange(M) == BAD, {BAD: "may not be written"}
        return replace(reading, refused=heard, away=away)

    def write(self, setpoints, which=None):
        kept = self.inside[BAD]
        applied = super().write(setpoints, which)
        asked = which is None or which[BAD]
        if self.kind == "disabled" and asked:
            self.inside[BAD] = kept
            self.heard = {BAD: "refuses puts: Channel write request failed"}
        elif self.kind == "silent" and asked:
            self.inside[BAD] = kept
        elif self.kind == "whole numbers":
            self.inside[BAD] = np.round(self.inside[BAD])
        elif self.kind == "narrow":
            self.inside[BAD] = np.clip(self.inside[BAD], -0.05, 0.05)
        return applied

    def setpoints(self):
        if self.kind == "narrow":
            self.drive[BAD] = -0.05, 0.05
        return super().setpoints()


class Bench:
    def __init__(self):
        self.machine = Refusing(new_clock())
        self.records = []
        policy = SvdPolicy(RESPONSE, SvdSettings(gain=0.5))
        self.runner = Runner(
            self.machine,
            PolicySlot(policy),
            LoopSettings(rate_hz=1 / PERIOD, ramp=0.0, proving=3),
            LimitSettings(setpoint=50.0, change_per_tick=50.0),
            # The loop that asks waits for its answers meanwhile: here, what becomes of puts alone.
            InterlockSettings(answer_reach=None),
            np.zeros(N),
            self.machine.clock,
            start=LoopState.CLOSED,
            safeguards=Safeguards(policy, without, drive_limits=lambda: self.machine.drive),
            subscribers=(self.records.append,),
        )
        self.steps(8)
        assert self.runner.state is LoopState.CLOSED

    def steps(self, count):
        for _ in range(count):
            self.runner.step()

    def kick(self, size=1.0):
        """Move the beam by something that correctors can repair."""
        self.machine.disturbance = RESPONSE @ np.array([0.3, -0.4, 1.0, 0.2]) * size

    def states(self):
        return [record.state for record in self.records]


@pytest.mark.parametrize("size", [0.1, 1.0, 5.0])
@pytest.mark.parametrize(
    ("kind", "held", "told"),
    [
        ("rights", 0, "COR2 (may not be written)"),
        ("disabled", 0, "COR2 (refuses puts: Channel write request failed"),
        ("silent", 1, "COR2 (does not keep puts: reads "),
        ("link", 1, "COR2 (does not keep puts: reads 0.02 A after "),
    ],
)
def test_a_corrector_that_does_not_take_puts_is_left_out_and_named(kind, held, told, size):
    bench = Bench()
    before = len(bench.records)
    bench.machine.kind = kind
    bench.kick(size)
    bench.steps(60)
    states = bench.states()[before:]
    assert LoopState.TRIPPED not in states
    began = sum(a is LoopState.CLOSED and b is LoopState.HELD for a, b in pairwise(states))
    assert began <= held
    assert bench.runner.state is LoopState.CLOSED
    reason = bench.runner.reason
    if size >= 1.0 or kind == "rights":
        assert "1 correctors do not follow and are left out: " + told in reason
    assert all(f"COR{other}" not in reason for other in range(M) if other != BAD)
    # the others have taken over
    rest = np.delete(RESPONSE, BAD, axis=1)
    best = bench.machine.disturbance + RESPONSE[:, BAD] * bench.machine.inside[BAD]
    best = best - rest @ np.linalg.lstsq(rest, best, rcond=None)[0]
    error = bench.records[-1].reading.orbit.position
    assert np.sqrt(np.mean(error**2)) <= 1.5 * np.sqrt(np.mean(best**2)) + 1e-6


@pytest.mark.parametrize("size", [1.0, 5.0])
def test_drive_limits_narrowed_at_run_time_hold_for_their_corrector(size):
    bench = Bench()
    before = len(bench.records)
    bench.machine.kind = "narrow"
    bench.kick(size)
    bench.steps(40)
    assert set(bench.states()[before:]) == {LoopState.CLOSED}
    assert bench.runner.reason == (
        "1 correctors at their drive limits: COR2 (-0.05 to 0.05 A) are left out"
    )
    assert np.abs(bench.records[-1].setpoints[BAD]) <= 0.05


def test_what_an_operator_moves_once_still_holds_and_names_it():
    bench = Bench()
    bench.machine.inside[1] += 0.3
    bench.steps(2)
    assert bench.runner.state is LoopState.HELD
    assert "setpoints were moved by somebody else: COR1" in bench.runner.reason
    bench.steps(10)
    assert bench.runner.state is LoopState.CLOSED and not bench.runner.reason


def test_more_that_refuse_than_may_be_lost_trip_with_their_names_and_cause():
    bench = Bench()
    bench.machine.heard = dict.fromkeys(range(M), "refuses puts: no")
    bench.steps(1)
    assert bench.runner.state is LoopState.TRIPPED
    assert (
        "4 correctors do not follow their setpoint: COR0 (refuses puts: no" in bench.runner.reason
    )


def test_a_corrector_that_was_left_out_counts_again_after_the_loop_was_opened():
    bench = Bench()
    bench.machine.heard = {BAD: "refuses puts: no"}
    bench.steps(3)
    assert "COR2 (refuses puts: no" in bench.runner.reason
    bench.runner.command("open")
    bench.steps(1)
    closing = bench.runner.command("close")
    bench.steps(2)
    assert closing.result(0) is LoopState.CLOSED
    bench.steps(2)
    assert not bench.runner.reason
