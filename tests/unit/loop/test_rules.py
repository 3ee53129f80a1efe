"""The whole loop under random events, against a small model of the rules."""

import os

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule
from scripted import ConstantPolicy, InversePolicy, M, N, ScriptedMachine, new_clock

from orbitfb.core.errors import ControlError
from orbitfb.core.signals import LoopState
from orbitfb.loop.commands import ORBIT_TO_CLOSE_ON
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings

LIMIT, STEP, PROVING = 3.0, 0.5, 2
ACTED = ("good", "one_nan")
EVENTS = (*ACTED, "good", "missing", "same_stamp", "frozen", "many_nan", "beam_lost",
          "current_unknown")  # fmt: skip


class Rules:
    """What the loop should do, from the words of the design alone."""

    def __init__(self):
        self.state, self.good, self.repeats, self.known = "OPEN", 0, 0, False
        self.ordered = None  # when the command to close came that waits for an orbit

    def legal(self, command):
        if command == "reset":
            return self.state == "TRIPPED"
        return self.state != "TRIPPED"

    def tick(self, now, event, command, finite_policy, write_fails, cannot_ask, moved):
        """Return whether exactly one write is tried."""
        if command == "close" and self.state != "CLOSED":
            self.ordered = now
        elif command:
            self.ordered = None
            self._enter(
                {"open": "OPEN", "shadow": "SHADOW", "reset": "OPEN"}.get(command, "CLOSED")
            )
        if event == "missing":
            if self.state == "CLOSED":
                self._enter("HELD")
            self.good, self.repeats = 0, self.repeats + 1
            if self.ordered is not None and now - self.ordered >= ORBIT_TO_CLOSE_ON:
                self.ordered = None
            return False
        closing, self.ordered = self.ordered is not None, None
        held = self.state == "HELD"
        asks = held or closing or moved or not self.known
        if asks:
            self.known = not cannot_ask
        verdict = self._verdict(event)
        if (
            verdict in ("fine", "repeated")
            and asks
            and (cannot_ask or self._disturbed(moved, closing))
        ):
            verdict = "hold"
        fine = verdict == "fine"
        if closing and fine:
            self._enter("CLOSED")
        self._react(verdict)
        if not fine:
            return False
        self.repeats = 0
        if self.state not in ("CLOSED", "SHADOW"):
            return False
        writes = self.state == "CLOSED" and finite_policy
        if self.state == "CLOSED" and not finite_policy:
            self._enter("TRIPPED")
        elif writes and write_fails:
            self.known = False
            self._enter("HELD")
        return writes

    def _disturbed(self, moved, closing):
        return moved and self.state == "CLOSED" and not closing

    def _verdict(self, event):
        if event == "beam_lost":
            return "trip"
        if event == "current_unknown":
            return "trip" if self.state == "CLOSED" else "hold"
        if event == "many_nan":
            return "hold"
        return "fine" if event in ACTED else "repeated"

    def _react(self, verdict):
        if self.state == "CLOSED":
            self.repeats += verdict == "repeated"
            if verdict == "trip":
                self._enter("TRIPPED")
            elif verdict == "hold" or self.repeats >= 2:
                self._enter("HELD")
        elif self.state == "HELD":
            self.good = self.good + 1 if verdict == "fine" else 0
            if verdict == "trip":
                self._enter("TRIPPED")
            elif self.good >= PROVING:
                self._enter("CLOSED")

    def _enter(self, state):
        if state != self.state:
            self.state, self.good, self.repeats = state, 0, 0


class LoopUnderFaults(RuleBasedStateMachine):
    def __init__(self):
        super().__init__()
        self.machine = ScriptedMachine(new_clock(), seed=3)
        self.slot = PolicySlot(InversePolicy())
        self.finite = True
        self.futures = []
        self.model = Rules()
        self.record = None
        self.first = True
        self.runner = Runner(
            self.machine,
            self.slot,
            LoopSettings(ramp=0.3, proving=PROVING),
            LimitSettings(setpoint=LIMIT, change_per_tick=STEP),
            # Random disturbances may well grow for five ticks: divergence has its own tests.
            InterlockSettings(max_invalid_bpms=2, divergence_ticks=1000, bpm_proving=1),
            np.zeros(N),
            self.machine.clock,
        )

    @rule(
        event=st.sampled_from(EVENTS),
        command=st.sampled_from((None, None, "open", "shadow", "close", "close", "reset")),
        write_fails=st.sampled_from((False, False, False, True)),
        cannot_ask=st.sampled_from((False, False, False, True)),
        mover=st.sampled_from((None, None, None, 0, 1, 2, 3)),
    )
    def anything(self, event, command, write_fails, cannot_ask, mover):
        self.tick(event, command, write_fails, cannot_ask, mover)

    @rule(count=st.integers(1, 5))
    def quiet(self, count):
        for _ in range(count):
            self.tick("good")

    @rule(event=st.sampled_from(EVENTS), count=st.integers(1, 3))
    def burst(self, event, count):
        for _ in range(count):
            self.tick(event)

    @rule(which=st.integers(0, M - 1))
    def nudge(self, which):
        """Move a corrector by less than a readback tells, while the loop is not closed."""
        if self.model.state != "CLOSED":
            self.machine.inside[which] += 0.04 if self.machine.inside[which] < 0 else -0.04

    def tick(self, event, command=None, write_fails=False, cannot_ask=False, mover=None):
        machine = self.machine
        if self.first and event in ("same_stamp", "frozen"):
            event = "good"
        if event != "missing":
            self.first = False
        if mover is not None:
            machine.inside[mover] += -2.0 if machine.inside[mover] > 0 else 2.0
        machine.write_error = "refused" if write_fails else None
        machine.setpoints_error = "no answer" if cannot_ask else None
        believed = self.runner._engine.memory.setpoints
        off = ~(np.abs(machine.inside - believed) <= 0.1)
        moved = bool(off.any()) and np.isfinite(believed).all()
        future = None
        if command:
            legal = self.model.legal(command)
            try:
                future = self.runner.command(command)
                assert legal
            except ControlError:
                assert not legal
                command = None
        machine.script.append(event)
        before, tried = machine.inside.copy(), len(machine.writes)
        self.record = self.runner.step()
        given = command, self.finite, write_fails, cannot_ask, moved
        expected = self.model.tick(machine.clock.monotonic(), event, *given)
        writes = machine.writes[tried:]
        assert self.record.state == self.model.state, self.record.reason
        assert len(writes) == expected
        assert event in ACTED or not writes
        if future is not None:
            self.futures.append(future)
        assert all(its.done() for its in self.futures) == (self.model.ordered is None)
        for written in writes:
            assert np.isfinite(written).all()
            assert (np.abs(written) <= np.maximum(LIMIT, np.abs(before))).all()
            # What is sent is a step from what is truly in force, not from a belief.
            assert (np.abs(written - before) <= STEP + 1e-12).all()
        if np.isfinite(self.record.written):
            assert self.record.state is LoopState.CLOSED
            np.testing.assert_allclose(self.record.applied, machine.inside - before, atol=1e-12)
        else:
            assert not self.record.applied.any()

    @rule(kicks=st.lists(st.floats(-50e-6, 50e-6), min_size=N, max_size=N))
    def disturb(self, kicks):
        self.machine.disturbance = np.array(kicks)

    @rule(kind=st.sampled_from(("inverse", "large", "nan", "infinite")))
    def swap(self, kind):
        policies = {
            "inverse": InversePolicy(),
            "large": ConstantPolicy([1e300, -1e300, 0, 1]),
            "nan": ConstantPolicy([0, np.nan, 0, 0]),
            "infinite": ConstantPolicy([0, 0, np.inf, 0]),
        }
        self.finite = kind in ("inverse", "large")
        self.slot.swap(policies[kind])

    @invariant()
    def every_tick_left_a_finite_record(self):
        if self.record is not None:
            for values in (self.record.requested, self.record.applied, self.record.dither):
                assert values.shape == (M,)
                assert np.isfinite(values).all()
            assert self.record.reason or self.record.state not in (
                LoopState.HELD,
                LoopState.TRIPPED,
            )


LoopUnderFaults.TestCase.settings = settings(
    max_examples=50, stateful_step_count=40, deadline=None, derandomize="CI" in os.environ
)
TestLoopUnderFaults = LoopUnderFaults.TestCase
