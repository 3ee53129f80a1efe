"""All that one tick hands to the next, as a value, and what a change of state does to it."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Channels, LoopState, Mask, Vector
from orbitfb.core.values import replace
from orbitfb.loop.correction.settings import USUAL, CorrectionSettings
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.states import Event, next_state
from orbitfb.loop.timing.pacing import Pace
from orbitfb.safety.answers.answering import opened
from orbitfb.safety.answers.owing import Answering
from orbitfb.safety.arrival import Sent
from orbitfb.safety.bpms import BpmMemory
from orbitfb.safety.frequency import Frequency
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings
from orbitfb.safety.prediction import Answers
from orbitfb.safety.refusals import Refusals
from orbitfb.safety.second_controller import SecondController
from orbitfb.safety.watch import Growth, LastOrbit, Rise


@dataclass(frozen=True, slots=True)
class Rules:
    """All that stays while the loop runs.

    Args:
        loop: Pacing, closing, holding.
        limits: Of what may be sent.
        interlocks: Their thresholds.
        reference: Reference orbit, shape (n,) [m].
        channels: Names behind the vectors.
        counting: BPMs that are not masked by configuration, shape (n,); None: all.
        correction: Of changes by hand.
    """

    loop: LoopSettings
    limits: LimitSettings
    interlocks: InterlockSettings
    reference: Vector
    channels: Channels
    counting: Mask | None = None
    correction: CorrectionSettings = USUAL


@dataclass(frozen=True, slots=True)
class Way:
    """The way back to good setpoints.

    Args:
        cause: Why the loop tripped.
        good: Where it leads, shape (m,) [A].
        steps: Steps that were sent.
        seen: Orbits since it began.
        rms: Least orbit error since [m].
    """

    cause: str
    good: Vector
    steps: int = 0
    seen: int = 0
    rms: float = float("inf")


@dataclass(frozen=True, slots=True)
class Gathered:
    """Orbit errors since the last correction, to be averaged.

    Args:
        total: Their sum, shape (n,) [m]; None: none yet.
        counts: Orbits in which each BPM counted, shape (n,).
        orbits: How many there were.
    """

    total: Vector | None = None
    counts: NDArray[np.int64] | None = None
    orbits: int = 0


@dataclass(frozen=True)
class LoopMemory:
    """What the loop knows between two ticks.

    Args:
        state: State of the loop.
        reason: Why it is in that state.
        recent: Setpoints in force, then those before, newest first, each (m,) [A]; NaN when
            unknown.
        policy_state: What the policy carries from tick to tick.
        growth: Memory of the divergence interlock.
        last: The orbit before this one.
        off: Ticks in a row that each corrector did not follow, shape (m,).
        pace: Place in the stream of orbits.
        since: When the state was entered, monotonic [s].
        bpms: What is remembered of every BPM.
        lost: Correctors that are left out as they do not follow, shape (m,).
        answers: What the last changes should have done, and did.
        sent: The last change, that may be on its way.
        sure: Of these the ticks in which it was there and its readback known, shape (m,).
        current: Stored current when it was last known [A]; NaN: not known.
        away: Correctors that could not be written at the last orbit, shape (m,); None: none.
        fresh: When the last orbit fit to act on was complete, monotonic [s].
        rise: Memory of the rate of the distortion.
        well: Setpoints of the last good orbit, shape (m,) [A]; None: not known, or not wanted.
        way: The way back to them after a trip; None: there is none.
        good: Good orbits in a row while HELD.
        recloses: Whether HELD ends by itself.
        moves: Moves of PVs to other servers that the loop knows of.
        moved: Why HELD does not end by itself: the last of these moves; else empty.
        mine: Correctors that the loop moves and whose setpoint it was told, shape (m,); None:
            not looked at yet. The others belong to whoever sets them.
        seen: Readback of each of the others when its setpoint was last asked for, shape (m,)
            [A]; NaN or None: not asked for.
        refusals: Correctors whose puts do not stay.
        answering: What was asked of the orbit without a sign of an answer.
        frequency: What is remembered of the RF frequency.
        second: What is remembered of a second controller.
        gathered: Orbit errors since the last correction.
    """

    state: LoopState
    reason: str
    recent: tuple[Vector, ...]
    policy_state: Any
    growth: Growth
    last: LastOrbit
    off: NDArray[np.int64]
    pace: Pace
    bpms: BpmMemory
    lost: Mask
    since: float
    fresh: float
    answers: Answers = field(default_factory=Answers)
    sent: Sent = field(default_factory=Sent)
    sure: NDArray[np.int64] | None = None
    current: float = float("nan")
    away: Mask | None = None
    rise: Rise = field(default_factory=Rise)
    well: Vector | None = None
    way: "Way | None" = None
    good: int = 0
    recloses: bool = True
    moves: int = 0
    moved: str = ""
    mine: Mask | None = None
    seen: Vector | None = None
    refusals: Refusals = field(default_factory=Refusals)
    answering: Answering = field(default_factory=Answering)
    frequency: Frequency = field(default_factory=Frequency)
    second: SecondController = field(default_factory=SecondController)
    gathered: Gathered = field(default_factory=Gathered)

    @property
    def setpoints(self) -> Vector:
        """Absolute setpoints in force, shape (m,) [A]; NaN when unknown."""
        return self.recent[0]


def first_memory(start: LoopState, rules: Rules, policy_state: Any, now: float) -> LoopMemory:
    """Build the memory of a loop that has not ticked yet.

    A loop that is to start CLOSED begins HELD: it proves a few orbits and closes by itself.

    Args:
        start: OPEN, SHADOW or CLOSED.
        rules: Settings and names.
        policy_state: Of the first policy.
        now: Monotonic [s].
    """
    closes = start is LoopState.CLOSED
    correctors = len(rules.channels.correctors)
    return LoopMemory(
        state=LoopState.HELD if closes else start,
        reason="starting: closes by itself after a few good orbits" if closes else "",
        recent=(np.full(correctors, np.nan),),
        policy_state=policy_state,
        growth=Growth(),
        last=LastOrbit(),
        off=np.zeros(correctors, dtype=np.int64),
        pace=Pace(),
        bpms=BpmMemory.first(len(rules.channels.bpms), rules.interlocks),
        lost=np.zeros(correctors, dtype=np.bool_),
        since=now,
        fresh=now,
    )


def confirm_setpoints(memory: LoopMemory, actual: Vector, tolerance: float | Vector) -> LoopMemory:
    """Take setpoints as the machine states them.

    What was sent before still explains a readback on its way, unless a setpoint is not what
    it was believed to be: then that history counts no longer. One that the loop does not move
    has no such history: wherever somebody else put it is where it has been.

    Args:
        memory: So far.
        actual: In force, shape (m,) [A].
        tolerance: Largest difference that is none, for all or shape (m,) [A].
    """
    if moved(memory, actual, tolerance).any():
        off = np.zeros_like(memory.off)
        sent = replace(memory.sent, change=None)
        memory = replace(memory, answers=Answers(), growth=Growth())
        return replace(memory, recent=(actual,), off=off, well=None, sent=sent)
    before, well = memory.recent[1:], memory.well
    if memory.mine is not None and not memory.mine.all():
        before = tuple(np.where(memory.mine, earlier, actual) for earlier in before)
        well = None if well is None else np.where(memory.mine, well, actual)
    return replace(memory, recent=(actual, *before), well=well)


def moved(memory: LoopMemory, actual: Vector, tolerance: float | Vector) -> Mask:
    """Find the setpoints of ours that are not what they were believed to be, shape (m,)."""
    other = ~(np.abs(actual - memory.setpoints) <= tolerance)
    return other if memory.mine is None else other & memory.mine


def forget_setpoints(memory: LoopMemory) -> LoopMemory:
    """Assume nothing of the setpoints until the machine states them."""
    unknown = np.full_like(memory.setpoints, np.nan)
    off, sent = np.zeros_like(memory.off), replace(memory.sent, change=None)
    return replace(memory, recent=(unknown,), off=off, well=None, sent=sent)


def move(memory: LoopMemory, event: Event, reason: str, now: float, recloses: bool) -> LoopMemory:
    """Let an event happen.

    Args:
        memory: So far.
        event: What happens.
        reason: Why; kept with the state.
        now: Monotonic [s].
        recloses: Whether a loop that is held now may close again by itself.

    Raises:
        ControlError: A command that is not legal in this state.
    """
    after = next_state(memory.state, event)
    if after is memory.state:
        latched = after in (LoopState.TRIPPED, LoopState.FAULT)
        return memory if latched else replace(memory, reason=reason, good=0)
    memory = replace(memory, state=after, reason=reason, since=now, good=0, moved="")
    if after in (LoopState.OPEN, LoopState.SHADOW):
        sent = replace(memory.sent, change=None)
        memory = replace(memory, lost=np.zeros_like(memory.lost), well=None, way=None, sent=sent)
        memory = replace(memory, refusals=Refusals(), answering=opened(memory.answering))
    if after is LoopState.CLOSED:
        return replace(memory, growth=Growth(), rise=Rise(), gathered=Gathered())
    if after is LoopState.HELD:
        return replace(memory, recloses=recloses)
    return memory


def note(memory: LoopMemory, reason: str, may_act: bool) -> LoopMemory:
    """Note an orbit that did not change the state.

    Args:
        memory: So far.
        reason: What there is to say about it.
        may_act: Whether it was good.
    """
    if memory.state in (LoopState.TRIPPED, LoopState.FAULT):
        return memory
    if memory.state is LoopState.HELD:
        if may_act:
            return replace(memory, good=memory.good + 1)
        return replace(memory, good=0, reason=reason or memory.reason)
    return memory if reason == memory.reason else replace(memory, reason=reason)
