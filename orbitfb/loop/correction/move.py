"""A change of the setpoints by hand: straight, in limited steps, between two known places.

A correction and its undoing are the same thing: a way from setpoints that were to setpoints that
shall be. It goes on only as long as an open loop could be closed: on each of its orbits the same
interlocks are asked, and the machine for its setpoints.
"""

from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import LoopState, Mask, Vector
from orbitfb.loop.memory import LoopMemory, Rules
from orbitfb.loop.tick import Checked
from orbitfb.safety.bounds import Bounds
from orbitfb.safety.limits import Limited, limit
from orbitfb.safety.refusals import tolerance_of
from orbitfb.safety.verdict import Action, name_some

WORSE, NOISE = 1.1, 5e-6
"""Growth of the rms orbit error [1], and [m] besides, over the larger of what it was at the start
and is expected to be at the end. The error is linear on a straight way and its rms convex, so that
it exceeds neither; the room is that of the way back after a trip (`loop.comeback`)."""
AWAY, AWAY_PERIODS = 2.0, 3.0
"""Without an orbit for so long [s] and [periods] the move ends, as an order to close does."""
ARRIVED = 1e-9
"""What is left of a way that is done [A]: rounding of numbers up to 20 A is 1e-14."""


@dataclass(frozen=True, slots=True)
class Move:
    """What is wanted.

    Args:
        name: What it is, for messages.
        start: Setpoints for which it was computed, shape (m,) [A]; it begins nowhere else.
        aim: Where it leads, shape (m,) [A].
        rms: Rms orbit error that is expected there [m].
    """

    name: str
    start: Vector
    aim: Vector
    rms: float

    def steps(self, step: float) -> int:
        """Count the steps.

        Args:
            step: Largest change of a setpoint in one of them [A].
        """
        return int(np.ceil(float(np.abs(self.aim - self.start).max(initial=0.0)) / step))


@dataclass(frozen=True, slots=True)
class Way:
    """How far a move has come.

    Args:
        move: What is wanted.
        at: Setpoints that the last step left, shape (m,) [A].
        since: When an orbit was last fit to act on, monotonic [s].
        before: Rms orbit error at its start [m]; NaN: it has not begun.
        rms: That of the last orbit [m].
        steps: Steps that were sent.
        good: Good orbits since the last of them.
    """

    move: Move
    at: Vector
    since: float
    before: float = float("nan")
    rms: float = float("nan")
    steps: int = 0
    good: int = 0


@dataclass(frozen=True, slots=True)
class Next:
    """What to do at an orbit.

    Args:
        way: How far it has come.
        limited: What to send; None: nothing.
        ends: Whether the move is over.
        reason: Why it ends before its aim; empty when it does not.
    """

    way: Way
    limited: Limited | None = None
    ends: bool = False
    reason: str = ""


def next_step(
    way: Way,
    memory: LoopMemory,
    checked: Checked,
    rules: Rules,
    mine: Mask,
    bounds: Bounds,
    now: float,
) -> Next:
    """Say what the next step is.

    Args:
        way: How far it has come.
        memory: Of the loop, with the setpoints that the machine has just stated.
        checked: The orbit of this tick, looked at as if the loop were to close.
        rules: Limits of the steps.
        mine: Correctors that the loop would move, shape (m,).
        bounds: Where the setpoint of each may be.
        now: When the orbit was complete, monotonic [s].
    """
    move = way.move
    if wrong := _wrong(way, memory, checked, rules, mine, now):
        return Next(way, ends=True, reason=wrong)
    if not checked.verdict.may_act:  # it does not count: as if it had not come
        return Next(way)
    way = replace(way, since=now, rms=checked.rms)
    if np.isnan(way.before):
        still = move.aim == move.start
        way = replace(way, before=checked.rms, at=np.where(still, memory.setpoints, move.start))
    elif not checked.rms <= (most := WORSE * max(way.before, move.rms) + NOISE):
        grown = f"{checked.rms * 1e6:.3g} µm rms, more than {most * 1e6:.3g} µm"
        return Next(way, ends=True, reason=f"the orbit error grew to {grown}")
    left = np.where(move.aim == move.start, 0.0, move.aim - way.at)
    largest = float(np.abs(left).max(initial=0.0))
    if largest <= ARRIVED:
        way = replace(way, good=way.good + 1)
        return Next(way, ends=way.good >= rules.loop.proving)
    step = min(rules.correction.step, rules.limits.change_per_tick)
    change = left if largest <= step else left * (step / largest)
    limited = limit(change, way.at, rules.limits, rules.channels.correctors, bounds)
    if limited.scale < 1.0:
        return Next(way, ends=True, reason=limited.verdict.reason)
    return Next(replace(way, at=limited.setpoints, steps=way.steps + 1, good=0), limited)


def _wrong(
    way: Way, memory: LoopMemory, checked: Checked, rules: Rules, mine: Mask, now: float
) -> str:
    """Say what ends a move at this orbit; empty when nothing does."""
    move, names = way.move, rules.channels.correctors
    if memory.state is not LoopState.OPEN:
        return f"the loop is {memory.state}; setpoints are changed by hand while it is OPEN"
    if checked.verdict.action > Action.SKIP:
        return checked.verdict.reason
    if now - way.since > max(AWAY, AWAY_PERIODS * rules.loop.period):
        why = f": {checked.verdict.reason}" if checked.verdict.reason else ""
        return f"no orbit to act on came for {now - way.since:.2g} s{why}"
    if (elsewhere := ~(np.abs(memory.setpoints - way.at) <= tolerance_of(rules.interlocks))).any():
        left = "where the last step left them" if way.steps else "those it was computed for"
        return f"setpoints are not {left}: {name_some(elsewhere, names)}"
    if (foreign := (move.aim != move.start) & ~mine).any():
        return f"the loop does not move {name_some(foreign, names)}"
    return ""
