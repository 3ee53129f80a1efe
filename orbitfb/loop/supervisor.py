"""The phases of one tick that send nothing: read, obey, check, supervise.

All that the loop remembers is one value (`LoopMemory`) and all that it decides is in pure
functions; here they meet the machine. What is sent to it is in `engine`.
"""

import threading
from collections.abc import Callable

import numpy as np

from orbitfb.core.names import FAST_FEEDBACK
from orbitfb.core.ports import Clock, Machine, Policy
from orbitfb.core.signals import LoopState, Mask, Reading, Vector
from orbitfb.core.values import replace
from orbitfb.loop import comeback
from orbitfb.loop import memory as remember
from orbitfb.loop.adjustments import Adjustments, approach
from orbitfb.loop.correction.hand import Hand
from orbitfb.loop.excitation.dither import Dither
from orbitfb.loop.frequency import Follower
from orbitfb.loop.guard import NONE, Guard, Safeguards
from orbitfb.loop.inquiry import Inquiry
from orbitfb.loop.inspection import Asker, inspect, look_for_second, mine_of
from orbitfb.loop.intake import Intake, await_orbit
from orbitfb.loop.lending.desk import Lending
from orbitfb.loop.lending.turn import Turn
from orbitfb.loop.memory import LoopMemory, Rules
from orbitfb.loop.slot import PolicySlot
from orbitfb.loop.states import Event
from orbitfb.loop.tick import Checked, screened, supervise, too_long, worse
from orbitfb.loop.timing.pacing import Pace, miss, take
from orbitfb.safety.prediction import Answers
from orbitfb.safety.verdict import Verdict
from orbitfb.safety.watch import Growth


class Supervisor:
    """Reads, checks, and keeps the state and the memory between two ticks; it sends nothing.

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
        slot.prepare = self._inquiry.prepare
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
        sent = memory.sent.began
        return await_orbit(
            self._machine, self._clock, patience, memory.pace, loop.period, stop, sent
        )

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
        if channel := self._rules.interlocks.fast_feedback_channel:
            closed = float(reading.auxiliary.get(channel, np.nan) != 0.0)
            reading = replace(reading, auxiliary={**reading.auxiliary, FAST_FEEDBACK: closed})
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
        if after.state is LoopState.TRIPPED and before is not LoopState.TRIPPED:
            self._guard.tripped()
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
