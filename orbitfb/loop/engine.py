"""The phases of one tick on a machine; the runner calls them in their order.

All that the loop remembers is one value (`LoopMemory`) and all that it decides is in pure
functions; here they meet the machine.
"""

import threading
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from orbitfb.core.errors import MachineError, NoOrbitError
from orbitfb.core.ports import Clock, Machine, Policy
from orbitfb.core.signals import LoopState, Mask, Reading, Vector
from orbitfb.loop import comeback
from orbitfb.loop import memory as remember
from orbitfb.loop.adjustments import Adjustments, approach
from orbitfb.loop.averaging import restrain
from orbitfb.loop.choice import Choice, choose
from orbitfb.loop.correction.hand import Hand
from orbitfb.loop.excitation.dither import Dither
from orbitfb.loop.frequency import Follower, Step
from orbitfb.loop.guard import NONE, Guard, Safeguards
from orbitfb.loop.inquiry import WAITS, Inquiry
from orbitfb.loop.inspection import Asker, inspect, look_for_second, mine_of
from orbitfb.loop.intake import Intake, await_orbit
from orbitfb.loop.lending.carrying import Carrying, trouble_of
from orbitfb.loop.lending.desk import Lending
from orbitfb.loop.lending.turn import Turn
from orbitfb.loop.memory import LoopMemory, Rules
from orbitfb.loop.slot import PolicySlot
from orbitfb.loop.states import Event
from orbitfb.loop.tick import Checked, ramp_gain, screened, supervise, too_long, worse
from orbitfb.loop.timing.pacing import Pace, miss, take
from orbitfb.loop.timing.waiting import wait_for_change
from orbitfb.loop.work import Work
from orbitfb.safety.limits import Limited
from orbitfb.safety.prediction import Answers, predict
from orbitfb.safety.verdict import Verdict
from orbitfb.safety.watch import Growth

PUT_BACK_STEP = 0.5
"""How long a loop that ends waits for the orbit between two steps of putting back [s]."""
SPEECHLESS = 10.0
"""Without a call for so long [s] a borrower is given up by a loop that ends: it computes for a
second at most, and a disk that takes longer to write a file does not work."""


class Engine:
    """Reads, checks, decides, limits and writes; keeps the memory between two ticks.

    Args:
        machine: The ring.
        slot: Where the policy in force lies.
        rules: Settings, reference, names.
        clock: The one on which the machine stamps.
        dither: Part of every change.
        start: OPEN, SHADOW or CLOSED.
        safeguards: What there is to fall back on.
        heed: Told which BPMs count, shape (n,), whenever that changes; None: nobody.
        random: Draws the questions to the ring; None: one that nobody can foretell.
        follower: Lets the RF frequency follow; None: it is left alone.

    Attributes:
        wanted: What operators want; any thread may put another value here.
        hand: Takes their orders to move setpoints while the loop is open.
        lending: Lends the machine of an open loop.
    """

    def __init__(
        self,
        machine: Machine,
        slot: PolicySlot,
        rules: Rules,
        clock: Clock,
        dither: Dither,
        start: LoopState,
        safeguards: Safeguards = NONE,
        heed: Callable[[Mask], None] | None = None,
        random: np.random.Generator | None = None,
        follower: Follower | None = None,
    ) -> None:
        self._machine, self._clock, self._follower = machine, clock, follower
        deadline = rules.loop.policy_deadline * rules.loop.period
        self._guard = Guard(slot, safeguards, clock, deadline)
        self._flaws = np.zeros(len(rules.channels.bpms), dtype=np.int8)
        self._asker = Asker(machine, self._guard)
        self._rules, self._dither = rules, dither
        self._random = random or np.random.default_rng()
        self._inquiry = Inquiry(rules, self._guard, self._random)
        self._counting, self._heed = rules.counting, heed
        loop, channels = rules.loop, rules.channels
        self.wanted: Adjustments = replace(
            Adjustments.none(rules.reference, len(channels.correctors)),
            average=loop.average,
            dead_band=(loop.dead_band,) * len(channels.planes),
        )
        self._adjustments: Adjustments = self.wanted
        self._turn = Turn()
        self.hand = Hand(rules.correction.undo_depth, self._turn)
        self.lending = Lending(channels, self._turn, loop.period / 2)
        self.memory = remember.first_memory(
            start, rules, self.policy.initial_state(), clock.monotonic()
        )

    @property
    def policy(self) -> Policy:
        """The policy that decides."""
        return self._guard.policy

    def read(self, stop: threading.Event) -> Intake:
        """Wait for the orbit of this tick; a closed loop no longer than until it must hold."""
        loop, memory = self._rules.loop, self.memory
        patience = loop.patience
        if memory.state is LoopState.CLOSED:
            patience -= self._clock.monotonic() - memory.fresh
        return await_orbit(self._machine, self._clock, patience, memory.pace, loop.period, stop)

    def take_policy(self) -> None:
        """Take the policy in force, with its initial state if it is a new one."""
        if self._guard.take():
            self.memory = replace(self.memory, policy_state=self.policy.initial_state())

    @property
    def reference(self) -> Vector:
        """Reference orbit in force, shape (n,) [m]."""
        return self._rules.reference

    def take_adjustments(self) -> None:
        """Take what operators want; while the loop is closed the reference follows slowly."""
        wanted, rules = self.wanted, self._rules
        if wanted is not self._adjustments:
            self._adjustments = wanted
            before = self._counting
            counting = wanted.enabled if before is None else wanted.enabled & before
            rules = replace(rules, counting=None if counting.all() else counting)
            if self._heed is not None:
                self._heed(counting)
        if rules.reference is not wanted.reference and self.memory.state is not LoopState.HELD:
            closed = self.memory.state is LoopState.CLOSED
            step = rules.loop.reference_speed * rules.loop.period if closed else np.inf
            rules = replace(rules, reference=approach(rules.reference, wanted.reference, step))
            # The error may grow while the loop follows; it is no sign of a wrong response then.
            self.memory = replace(self.memory, well=None, growth=Growth())
        self._rules = rules

    def believed(self, reading: Reading) -> Reading:
        """Let BPMs be not valid that operators have disabled, or that cannot be believed."""
        reading, self._flaws, self.memory = screened(reading, self.memory, self._rules)
        if self._follower is not None:
            reading = self._follower.tell(reading)
        enabled = self._adjustments.enabled
        if enabled.all():
            return reading
        orbit = replace(reading.orbit, valid=reading.orbit.valid & enabled)
        return replace(reading, orbit=orbit)

    def move(self, event: Event, reason: str) -> None:
        """Let an event happen.

        Raises:
            ControlError: A command that is not legal in this state.
        """
        before, now = self.memory.state, self._clock.monotonic()
        after = remember.move(self.memory, event, reason, now, self._rules.loop.reclose)
        if after.state is LoopState.CLOSED and before is not LoopState.CLOSED:
            if before is not LoopState.HELD:
                self._guard.forgive()
            after = replace(after, policy_state=self.policy.initial_state())
            self._dither.restart(before is LoopState.HELD)
        self.memory = after

    def without_orbit(self, intake: Intake) -> int:
        """Live through a tick to which no orbit came; return how many are missed by now."""
        now, loop = self._clock.monotonic(), self._rules.loop
        missed, pace = miss(now, intake.pace, loop.period)
        self.memory = replace(self.memory, pace=pace)
        self.move(Event.ORBIT_MISSING, intake.absence)
        self.memory = comeback.stop(self.memory, intake.absence)
        if self.memory.state is LoopState.HELD:
            happening = too_long(self.memory, intake.absence, now, loop)
            if happening.event:
                self.move(happening.event, happening.reason)
        return missed

    def check(self, reading: Reading, pace: Pace, closing: bool) -> tuple[Checked, int]:
        """Ask the interlocks, about setpoints that the machine states whenever in doubt.

        Args:
            reading: The orbit of this tick.
            pace: Stream of orbits up to it.
            closing: Whether the loop is asked to close on it.

        Returns:
            The checked orbit, and how many orbits were missed before it.
        """
        stamp, loop = reading.orbit.time, self._rules.loop
        missed, pace = take(stamp, reading.received, pace, loop.period)
        self.memory = replace(self.memory, pace=pace)
        if missed:
            self.memory = replace(self.memory, answers=Answers())
            self.memory = self._inquiry.missed(self.memory, missed)
        found, self.memory = self._inquiry.look(self.memory, reading, self._mine())
        checked = inspect(self._asker, self.memory, reading, self._rules, self._flaws, closing)
        checked = worse(checked, found)
        draw = self._random.random
        checked = look_for_second(checked, reading, self._rules, self._mine(), closing, draw)
        self.memory = comeback.remember_good(checked.memory, checked, self._rules)
        if self._follower is not None:
            self.memory = self._follower.look(self.memory, reading)
        return checked, missed

    def _state_setpoints(self, reading: Reading) -> tuple[LoopMemory, str]:
        answer = self._asker.ask(self.memory, self._rules, reading)
        self.memory, moved = answer.memory, answer.moved
        return self.memory, answer.trouble or (moved and f"setpoints were moved: {moved}")

    def _mine(self) -> Mask:
        """Correctors that the loop moves now, shape (m,)."""
        return mine_of(self._guard, self.memory)

    def supervise(self, reading: Reading, verdict: Verdict) -> None:
        """Let a verdict have its effect on the state."""
        now = self._clock.monotonic()
        before = self.memory.state
        happening = supervise(self.memory, verdict, now, self._rules.loop)
        if happening.event:
            self.move(happening.event, happening.reason)
            self.memory = comeback.set_out(self.memory, before, verdict, self._rules)
        else:
            self.memory = remember.note(self.memory, happening.reason, verdict.may_act)
        self._heed_move(reading)
        if verdict.may_act:
            self.memory = replace(self.memory, fresh=reading.received)

    def _heed_move(self, reading: Reading) -> None:
        """Hold a closed loop whose PVs come from another server, until an operator closes it."""
        if reading.moves > self.memory.moves:
            if self.memory.state is LoopState.CLOSED:
                self.move(Event.HOLD, reading.moved)
            if self.memory.state is LoopState.HELD:
                self.memory = replace(self.memory, recloses=False, moved=reading.moved)
            self.memory = comeback.stop(self.memory, reading.moved)
            self.memory = replace(self.memory, moves=reading.moves)
        if self.memory.moved and self.memory.good:  # else the reason is what else is wrong
            self.memory = replace(self.memory, reason=self.memory.moved)

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
        begin, calls = self._clock.monotonic(), -1
        while (loan := self.lending.loan) is not None:
            loan.call_back(reason)
            work = Work(self._clock, self.memory.setpoints, np.zeros(len(loan.lent)))
            absence = ""
            try:
                work.reading = self._machine.read(PUT_BACK_STEP)
            except Exception as error:  # also what led to FAULT: putting back needs no orbit
                absence = str(error) or type(error).__name__
            self.lend(work, absence, None)
            if loan.calls != calls:
                begin, calls = self._clock.monotonic(), loan.calls
            elif self._clock.monotonic() - begin > SPEECHLESS:
                self.lending.give_up()

    def _step(self, reading: Reading, mine: Mask) -> Step | None:
        """Ask whether the RF frequency is to be stepped with this tick."""
        if self._follower is None:
            return None
        step, self.memory = self._follower.propose(self.memory, reading, self._guard.response, mine)
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
        try:
            applied = self._machine.write(limited.setpoints, mine)
        except MachineError as error:
            self.memory = remember.forget_setpoints(self.memory)
            self.move(Event.HOLD, f"writing failed: {error}")
            return False
        finally:
            work.done("act")
        sent = np.where(mine, applied.setpoints, before)
        work.applied = sent - before
        work.written = applied.time
        work.latency = applied.monotonic - reading.received
        lag = self._rules.interlocks.readback_lag
        change = replace(self.memory.sent, change=work.applied, waited=0)
        self.memory = replace(self.memory, recent=(sent, *self.memory.recent[:lag]), sent=change)
        return True
