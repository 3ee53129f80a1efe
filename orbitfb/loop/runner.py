"""The runner: paces the ticks, swaps the policy between two of them, obeys commands.

The machine gives the beat: a tick begins when the orbit it waits for is complete. Commands and
swaps that came during the wait take effect before that orbit is looked at.
"""

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future

import numpy as np

from orbitfb.core.errors import ConfigError, ControlError
from orbitfb.core.ports import Clock, Machine, Subscriber
from orbitfb.core.signals import LoopState, Mask, TickRecord, Vector
from orbitfb.loop.adjustments import Adjustments
from orbitfb.loop.commands import Commands
from orbitfb.loop.correction.hand import Hand
from orbitfb.loop.correction.settings import USUAL, CorrectionSettings
from orbitfb.loop.engine import Engine
from orbitfb.loop.excitation.dither import Dither
from orbitfb.loop.frequency import Follower
from orbitfb.loop.guard import NONE, Safeguards
from orbitfb.loop.lending.desk import Lending
from orbitfb.loop.lending.lent import LentMachine
from orbitfb.loop.memory import Rules
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.loop.states import Event
from orbitfb.loop.work import Work
from orbitfb.safety.believed import Believed
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings


class Runner:
    """Runs the loop in its caller's thread.

    Args:
        machine: The ring.
        slot: Where the policy in force lies.
        settings: Pacing, closing, holding.
        limits: Of what may be sent.
        interlocks: Their thresholds.
        reference: Reference orbit, shape (n,) [m].
        clock: The one on which the machine stamps `received` and `monotonic`.
        dither: Part of every change; none by default.
        start: OPEN, SHADOW, or CLOSED: then it closes by itself after a few good orbits.
        subscribers: Get every record, in this thread.
        counting: BPMs that are not masked by configuration, shape (n,); None: all.
        safeguards: What there is to fall back on: a baseline, correctors that can be left out.
        heed: Told which BPMs count, shape (n,), whenever operators change it; None: nobody.
        random: Draws the questions to the ring; None: one that nobody can foretell, as a machine
            needs it. With a seed the same loop asks the same.
        follower: Lets the RF frequency follow; None: it is left alone.
        correction: Of changes by hand.

    Attributes:
        failure: What led to FAULT, for the log; None otherwise.
        subscriber_failures: Count of records that a subscriber raised on.
        last_subscriber_failure: What the last of them raised; empty if none did.
        believed: Which ticks the ring answered; any thread may read it.

    Raises:
        ConfigError: The reference does not fit the machine, or the start is no start.
    """

    def __init__(
        self,
        machine: Machine,
        slot: PolicySlot,
        settings: LoopSettings,
        limits: LimitSettings,
        interlocks: InterlockSettings,
        reference: Vector,
        clock: Clock,
        dither: Dither | None = None,
        start: LoopState = LoopState.OPEN,
        subscribers: Sequence[Subscriber] = (),
        counting: Mask | None = None,
        safeguards: Safeguards = NONE,
        heed: Callable[[Mask], None] | None = None,
        random: np.random.Generator | None = None,
        follower: Follower | None = None,
        correction: CorrectionSettings = USUAL,
    ) -> None:
        channels = machine.channels
        n, m = len(channels.bpms), len(channels.correctors)
        if reference.shape != (n,) or not np.isfinite(reference).all():
            raise ConfigError(f"the reference orbit must be {n} finite numbers [m], one per BPM")
        if start not in (LoopState.OPEN, LoopState.SHADOW, LoopState.CLOSED):
            raise ConfigError(f"a loop cannot start {start}: choose OPEN, SHADOW or CLOSED")
        rules = Rules(
            settings, limits, interlocks, reference.copy(), channels, counting, correction
        )
        self._rules, self._clock = rules, clock
        self._engine = Engine(
            machine,
            slot,
            rules,
            clock,
            dither or Dither.off(m),
            start,
            safeguards,
            heed,
            random,
            follower,
        )
        self._subscribers = tuple(subscribers)
        self._nothing = np.zeros(m)
        self._nothing.flags.writeable = False
        self._commands = Commands(self._engine, clock.monotonic)
        self._stop = threading.Event()
        self._ticks = 0
        self.believed = Believed()
        self.failure: Exception | None = None
        self.subscriber_failures = 0
        self.last_subscriber_failure = ""

    @property
    def state(self) -> LoopState:
        """State of the loop."""
        return self._engine.memory.state

    @property
    def reason(self) -> str:
        """Why it is in that state."""
        return self._engine.memory.reason

    @property
    def ticks(self) -> int:
        """Count of ticks since the loop was built."""
        return self._ticks

    @property
    def adjustments(self) -> Adjustments:
        """What operators want."""
        return self._engine.wanted

    @property
    def reference(self) -> Vector:
        """Reference orbit in force, shape (n,) [m]: on its way to the one that is wanted."""
        return self._engine.reference

    @property
    def hand(self) -> Hand:
        """Takes orders to move setpoints while the loop is open."""
        return self._engine.hand

    @property
    def lending(self) -> Lending:
        """Whether the machine is lent."""
        return self._engine.lending

    def lend(self, name: str, correctors: Mask) -> LentMachine:
        """Lend the machine of an open loop to a procedure in the caller's thread.

        The loop answers each of its calls at a tick. As soon as the loop could not close, or has to
        end, it calls the machine back: the procedure must put back what it moved, and close it.

        Args:
            name: What for, for messages.
            correctors: Those that may be written, shape (m,).

        Raises:
            ControlError: The loop is not open, setpoints are being moved, or the loop has ended.
        """
        if self.state is not LoopState.OPEN:
            first = "reset" if self.state is LoopState.TRIPPED else "open"
            raise ControlError(f"{name} refused: the loop is {self.state}; `{first}` it first")
        return self._engine.lending.lend(name, correctors)

    def subscribe(self, subscriber: Subscriber) -> None:
        """Give every record from the next tick on to one more; may be called from any thread."""
        self._subscribers = (*self._subscribers, subscriber)

    def adjust(self, wanted: Adjustments) -> None:
        """Take other adjustments; they are in force from the next tick on.

        Args:
            wanted: All of them.

        Raises:
            ControlError: One of them does not fit the machine.
        """
        wanted.check(self._rules.channels)
        self._engine.wanted = wanted

    def command(self, name: str) -> Future[LoopState]:
        """Give a command; it takes effect before the next orbit is acted on.

        Args:
            name: `open`, `shadow`, `close` or `reset`.

        Returns:
            Its outcome: the state after it, or a `ControlError` with what refused it (closing
            asks the interlocks, which takes an orbit, waited for up to `ORBIT_TO_CLOSE_ON`).

        Raises:
            ControlError: No such command, not legal in the present state, or the loop ended.
        """
        return self._commands.give(name)

    def run(self, stop: threading.Event) -> None:
        """Tick until told to stop, or FAULT; setpoints stay where they are.

        Args:
            stop: Set it from any thread.
        """
        self._stop = stop
        while not stop.is_set() and self.state is not LoopState.FAULT:
            begin = self._clock.monotonic()
            _, acted = self._once()
            if not acted:
                # A machine that fails or repeats itself at once must not make the loop spin.
                spent = self._clock.monotonic() - begin
                stop.wait(max(0.0, self._rules.loop.period / 2 - spent))
        self._end(f"the loop has ended in {self.state}")

    def step(self) -> TickRecord:
        """Do one tick and return its record."""
        record, _ = self._once()
        return record

    def _once(self) -> tuple[TickRecord, bool]:
        """Do one tick; return its record and whether its orbit was fit to act on."""
        engine = self._engine
        work = Work(self._clock, engine.memory.setpoints, self._nothing)
        fit = False
        if self.state is not LoopState.FAULT:
            try:
                fit = self._tick(work)
            except Exception as error:  # the outermost guard: FAULT reports it
                self.failure = error
                engine.move(Event.FAULT, f"{type(error).__name__}: {error}")
        if self.state is LoopState.FAULT:
            self._commands.closing.refuse(self.reason)
            self._end(f"the loop has failed: {self.reason}")
        record = work.record(self._ticks, engine.memory, engine.reference, engine.policy.policy_id)
        self.believed = self.believed.follow(self._ticks, engine.memory.answering)
        self._ticks += 1
        for subscriber in self._subscribers:
            try:
                subscriber(record)
            except Exception as error:  # a listener must not stop the loop; counted and kept
                self.subscriber_failures += 1
                self.last_subscriber_failure = f"{subscriber!r} raised {error!r}"
        return record, fit

    def _tick(self, work: Work) -> bool:
        engine = self._engine
        intake = engine.read(self._stop)
        work.done("read")
        engine.take_policy()
        engine.take_adjustments()
        self._commands.obey()
        if intake.reading is None:
            if not intake.absence:  # told to stop while it waited: nothing is wrong
                return False
            work.missed = engine.without_orbit(intake)
            engine.lend(work, intake.absence, None)
            if self.state is LoopState.TRIPPED or self._commands.closing.overdue:
                self._commands.closing.refuse(intake.absence)
            return False
        reading = work.reading = engine.believed(intake.reading)
        checked, work.missed = engine.check(
            reading, intake.pace, bool(self._commands.closing) or engine.by_hand
        )
        work.setpoints = engine.memory.setpoints
        self._commands.close(checked.verdict)
        engine.supervise(reading, checked.verdict)
        work.done("check")
        if self.state is LoopState.TRIPPED or engine.hand.busy:
            engine.step_aside(work, reading, checked)
        engine.lend(work, "", checked)
        if not checked.verdict.may_act:
            return False
        if self.state in (LoopState.SHADOW, LoopState.CLOSED):
            engine.act(work, reading, checked)
        return True

    def _end(self, reason: str) -> None:
        """Refuse what is ordered and whatever comes later."""
        self._commands.end(reason)
        self._engine.end(reason)
