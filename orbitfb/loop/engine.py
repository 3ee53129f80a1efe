"""The phases of one tick that send something: decide, limit, act, and moves for others."""

import numpy as np

from orbitfb.core.errors import MachineError, NoOrbitError
from orbitfb.core.signals import LoopState, Mask, Reading, Vector
from orbitfb.core.values import replace
from orbitfb.loop import comeback
from orbitfb.loop import memory as remember
from orbitfb.loop.averaging import restrain
from orbitfb.loop.choice import Choice, choose
from orbitfb.loop.frequency import Step
from orbitfb.loop.inquiry import WAITS
from orbitfb.loop.lending.carrying import Carrying, trouble_of
from orbitfb.loop.states import Event
from orbitfb.loop.supervisor import Supervisor
from orbitfb.loop.tick import Checked, ramp_gain
from orbitfb.loop.timing.waiting import wait_for_change
from orbitfb.loop.work import Work
from orbitfb.safety.limits import Limited
from orbitfb.safety.prediction import Answers, predict
from orbitfb.safety.watch import Growth

PUT_BACK_STEP = 0.5
"""How long a loop that ends waits for the orbit between two steps of putting back [s]."""


class Engine(Supervisor):
    """Decides, limits and writes; the runner calls its phases in their order."""

    def act(self, work: Work, reading: Reading, checked: Checked) -> None:
        """Decide and limit; write if CLOSED.

        Args:
            work: The tick in hand.
            reading: Its orbit.
            checked: The same, found fit to act on.
        """
        rules, guard = self._rules, self._guard
        if closed := self.memory.state is LoopState.CLOSED:
            work.held_back, self.memory, trouble = wait_for_change(
                self.memory,
                reading,
                checked,
                rules,
                self._mine(),
                lambda: self._state_setpoints(reading),
            )
            if trouble:
                self.move(Event.HOLD, trouble)
            if work.held_back:
                return self._expect(work.nothing, None)
        memory = self.memory
        ramp = ramp_gain(reading.received - memory.since, rules.loop) if closed else 1.0
        question = self._inquiry.question(memory, checked) if closed else None
        dither = self._dither.propose(question) if closed else work.nothing
        waits = closed and self._inquiry.waits(memory)
        mine, heeded = self._mine(), self._inquiry.heeded(memory, checked)
        acts = restrain(memory.gathered, heeded.checked, self._adjustments, rules.channels)
        memory = self.memory = replace(memory, gathered=acts.gathered)
        deciding = self.policy
        gain = (0.0 if waits else ramp) * self._adjustments.gain * acts.share
        may_step = closed and ramp == 1.0 and not waits and not heeded.reason
        step = self._step(reading, mine) if may_step else None

        def chosen(step: Step | None) -> Choice:
            besides = None if step is None else step.change
            resting, its = heeded.resting, acts.checked
            return choose(
                guard, its, memory, rules, gain, dither, mine, resting, work.done, besides
            )

        choice = chosen(step)
        if step is not None and not self._put(step, choice):
            step, choice = None, chosen(None)
        limited, policy_state = choice.limited, choice.policy_state
        if not limited.verdict.may_act:
            self.move(Event.TRIP, f"policy {deciding.policy_id}: {limited.verdict.reason}")
            return
        if self.policy is not deciding:
            self.memory = replace(self.memory, policy_state=self.policy.initial_state())
        work.requested, work.dither, work.scale = choice.requested, choice.dither, limited.scale
        doubts = WAITS if waits else heeded.reason
        if waits:  # what the orbit does meanwhile is not of the loop's doing
            memory = self.memory = replace(memory, growth=Growth(), answers=Answers())
        told = "; ".join(filter(None, (checked.verdict.reason, *choice.reasons, doubts)))
        self.memory = remember.note(self.memory, told, may_act=True)
        if not closed:
            return
        if (age := self._clock.monotonic() - reading.received) > rules.loop.patience:
            self.move(Event.HOLD, f"the orbit was {age:.3g} s old when it came to writing")
            return
        if self._write(work, reading, limited):
            self._dither.settle(limited.scale * choice.dither)
            asked = limited.scale == 1.0 and np.array_equal(choice.dither[mine], dither[mine])
            self._expect(work.applied, question if asked else None, step, reading)
            settled = ramp == 1.0 and not doubts and choice.settled and acts.due
            if settled and policy_state is not self.memory.policy_state:
                self.memory = replace(self.memory, policy_state=policy_state)
            sent, hertz = work.applied, 0.0
            if step is not None and guard.learns_rf:
                hertz = step.hertz
            elif step is not None:
                sent = sent - step.change
            learnt = guard.inform(checked, sent, self.memory.policy_state, hertz)
            self.memory = replace(self.memory, policy_state=learnt)

    def step_aside(self, work: Work, reading: Reading, checked: Checked) -> None:
        """Make a step that no policy asks for: back after a trip, or of a move by hand.

        Args:
            work: The tick in hand.
            reading: Its orbit.
            checked: The same; for a move by hand looked at as if the loop were to close.
        """
        memory, rules, mine = self.memory, self._rules, self._mine()
        bounds = self._guard.bounds(rules.limits.setpoint, len(mine))
        limited = None
        if memory.state is LoopState.TRIPPED and memory.way is not None:
            ask = self._state_setpoints
            step = comeback.next_step(memory, checked, rules, mine, lambda: ask(reading), bounds)
            self.memory, limited = step.memory, step.limited
        if self.hand.busy:  # in no other state than OPEN does it give a step
            limited = self.hand.step(self.memory, checked, reading, rules, mine, bounds) or limited
        if limited is None:
            return
        work.requested = limited.change
        if not self._write(work, reading, limited):
            self.hand.fail(self.memory.reason)
            self.memory = comeback.stop(self.memory, "a write failed")

    @property
    def by_hand(self) -> bool:
        """Whether setpoints of the open loop are being moved for somebody."""
        return self.hand.busy or self.lending.busy

    def lend(self, work: Work, absence: str, checked: Checked | None) -> None:
        """Serve whoever has borrowed the machine.

        Args:
            work: The tick in hand.
            absence: Why it has no orbit; empty when it has one.
            checked: That orbit, looked at as if the loop were to close; None: there is none.
        """
        loan, rules, mine = self.lending.loan, self._rules, self._mine()
        if loan is None:
            return
        now, reading = self._clock.monotonic(), work.reading
        loan.call_back(trouble_of(loan.lent, self.memory, reading, checked, rules, mine, now))
        if checked is not None and not checked.verdict.may_act:
            absence = checked.verdict.reason
        given = NoOrbitError(absence) if reading is None or absence else reading
        bounds = self._guard.bounds(rules.limits.setpoint, len(mine))
        carrying = Carrying(self._machine, self.memory, rules, bounds, work)
        self.lending.serve(given, carrying)
        told = "; ".join(filter(None, (carrying.memory.reason, f"{loan.name} is under way")))
        self.memory = remember.note(carrying.memory, told, may_act=True)

    def end(self, reason: str) -> None:
        """Let nobody move setpoints any more; a borrower may put back first what it moved.

        Args:
            reason: Why.
        """
        self._turn.end(reason)
        self.hand.end(reason)
        self.lending.end(reason, self._put_back, self._clock.monotonic)

    def _put_back(self) -> None:
        """Serve a borrower of a loop that has ended."""
        work = Work(self._clock, self.memory.setpoints, np.zeros_like(self.memory.setpoints))
        absence = ""
        try:
            work.reading = self._machine.read(PUT_BACK_STEP)
        except Exception as error:  # also what led to FAULT: putting back needs no orbit
            absence = str(error) or type(error).__name__
        self.lend(work, absence, None)

    def _step(self, reading: Reading, mine: Mask) -> Step | None:
        """Ask whether the RF frequency is to be stepped with this tick."""
        if self._follower is None:
            return None
        guard = self._guard
        step, self.memory = self._follower.propose(
            self.memory, reading, guard.response, mine, guard.rf
        )
        return step

    def _put(self, step: Step, choice: Choice) -> bool:
        """Put a step of the RF frequency, if all that goes with it may be sent."""
        if self._follower is None or not choice.whole:
            return False
        sent, self.memory = self._follower.put(step, self.memory, self._clock.monotonic())
        return sent

    def _expect(
        self,
        applied: Vector,
        question: Vector | None,
        step: Step | None = None,
        reading: Reading | None = None,
    ) -> None:
        """Remember what was just sent should do to the orbit.

        A step of the frequency and what goes with it undo each other: nothing is expected of them.
        """
        if step is not None and reading is not None and self._follower is not None:
            moved = self._guard.predict(applied)
            if moved is not None:
                self.memory = self._follower.sent(step, self.memory, reading, moved)
            applied = applied - step.change
        answer = self._guard.predict(applied)
        if answer is not None:
            answers = predict(answer, self.memory.answers, self._rules.interlocks)
            self.memory = replace(self.memory, answers=answers)
            self.memory = self._inquiry.sent(self.memory, applied, answer, question, self._mine())

    def _write(self, work: Work, reading: Reading, limited: Limited) -> bool:
        before, mine = self.memory.setpoints, self._mine()
        began = self._clock.monotonic()
        try:
            applied = self._machine.write(limited.setpoints, mine)
        except MachineError as error:
            self.memory = remember.forget_setpoints(self.memory)
            self.move(Event.HOLD, f"writing failed: {error}")
            return False
        finally:
            work.done("act")
        sent = np.where(mine, applied.setpoints, before)
        lag = self._rules.interlocks.readback_lag
        self.memory = work.remember_sent(sent, before, applied, began, self.memory, lag)
        return True
