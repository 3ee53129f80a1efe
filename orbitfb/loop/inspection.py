"""An orbit looked at with setpoints that the machine states whenever in doubt.

The loop puts its own correctors alone: those that the policy moves and that follow. The others,
disabled, masked or left out, belong to whoever sets them. Where those were put is asked for when
their readback says that it is elsewhere, so that every record tells it, and once more when one is
given to the loop: it takes over from the setpoint in force.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from orbitfb.core.ports import Machine
from orbitfb.core.signals import LoopState, Mask, Reading, Vector
from orbitfb.core.values import replace
from orbitfb.loop import comeback
from orbitfb.loop.asking import Answer, ask_setpoints
from orbitfb.loop.guard import Guard
from orbitfb.loop.memory import LoopMemory, Rules
from orbitfb.loop.tick import Checked, check, worse
from orbitfb.safety.bpms import Flaws
from orbitfb.safety.culprit import culprit
from orbitfb.safety.prediction import Answers
from orbitfb.safety.refusals import doubtful, judge, settled
from orbitfb.safety.verdict import Action, Verdict, name_some
from orbitfb.safety.watch import Growth

RESPONSE = frozenset({"prediction", "divergence"})
"""Interlocks that blame the response matrix: before they do, the setpoints are asked for."""


@dataclass(frozen=True, slots=True)
class Asker:
    """Whom to ask.

    Args:
        machine: For its setpoints.
        guard: Which correctors may move, and whether the machine may be written to.
    """

    machine: Machine
    guard: Guard

    def ask(
        self, memory: LoopMemory, rules: Rules, reading: Reading, doubted: bool = False
    ) -> Answer:
        """Have the machine state its setpoints; say what keeps from writing.

        A closed loop finds out why a setpoint is not what it sent: a corrector that does not take
        puts is left out, and has not been moved by anybody.

        Args:
            memory: So far.
            rules: Tolerance and names.
            reading: The orbit of this tick, with readbacks and refusals.
            doubted: Whether the response is about to be called wrong.
        """
        response = self.guard.response if doubted else None
        answer = ask_setpoints(self.machine, memory, rules, reading.away, response)
        answer = replace(answer, trouble=answer.trouble or self.guard.obstacle())
        if not answer.known:
            return answer
        after, refusals = answer.memory, answer.memory.refusals
        closed = memory.state is LoopState.CLOSED
        if closed and answer.other is not None and answer.other.any():
            judged = judge(
                answer.other,
                after.setpoints,
                memory.setpoints,
                self.guard.bounds(rules.limits.setpoint, len(after.setpoints)),
                reading.refused,
                refusals,
                reading.received,
                rules.interlocks,
            )
            if self.guard.can_leave_out:
                refusals = judged.refusals
            else:  # one that does not take puts holds the loop, as somebody's hand does
                judged.moved[list(judged.refusals.found)] = True
            answer = replace(answer, moved=name_some(judged.moved, rules.channels.correctors))
        refusals = settled(refusals, reading.readback, after.setpoints)
        return replace(answer, memory=replace(after, refusals=refusals))


def mine_of(guard: Guard, memory: LoopMemory) -> Mask:
    """Correctors that the loop moves now, shape (m,): may move, follow, and are known.

    Args:
        guard: Which may move.
        memory: Which do not follow, and which were taken over.
    """
    may = guard.movable(len(memory.lost)) & ~memory.lost
    return may if memory.mine is None else may & memory.mine


def inspect(
    asker: Asker,
    memory: LoopMemory,
    reading: Reading,
    rules: Rules,
    flaws: Flaws,
    closing: bool,
) -> Checked:
    """Ask the interlocks, and the machine for its setpoints if there is a doubt about them.

    Args:
        asker: Whom to ask.
        memory: So far.
        reading: The orbit of this tick.
        rules: Settings and names.
        flaws: What is wrong with each BPM, shape (n,).
        closing: Whether the loop is asked to close on it.
    """
    guard, closed = asker.guard, memory.state is LoopState.CLOSED
    movable = guard.movable(len(memory.setpoints))
    may = movable & ~memory.lost
    mine = may if memory.mine is None else may & memory.mine
    given = bool((may & ~mine).any())
    unknown = bool(np.isnan(memory.setpoints).any())
    memory = replace(memory, mine=None if memory.mine is None else mine)
    trouble = moved = ""
    doubt = closing or unknown or given or memory.state is LoopState.HELD
    if doubt:
        answer = asker.ask(memory, rules, reading)
        memory, trouble = answer.memory, answer.trouble
        if given and not unknown:
            moved = answer.moved
    if not trouble:
        memory = replace(memory, mine=may)

    def checked_with(memory: LoopMemory) -> Checked:
        return check(reading, memory, rules, flaws, movable, guard.can_leave_out)

    slow = False
    if not doubt:
        slow, refusals = doubtful(
            reading.readback, memory.recent, mine, memory.refusals, rules.interlocks
        )
        memory = replace(memory, refusals=refusals)
    checked = checked_with(memory)
    seen = memory.seen
    if not doubt:
        sudden = bool((checked.off & mine).any()) or _back(memory, reading, may)
        sudden = sudden or any(mine[index] for index in reading.refused)
        doubted = closed and checked.verdict.cause in RESPONSE
        sudden = sudden or slow or doubted
        strays, seen = _strayed(checked.off & ~may, reading.readback, memory.seen, rules)
        if sudden or strays or _back(memory, reading, ~may):
            answer = asker.ask(memory, rules, reading, doubted)
            if sudden or answer.known:  # what is not ours holds nobody
                memory, trouble, moved = answer.memory, answer.trouble, answer.moved
                if moved:
                    memory = comeback.stop(memory, f"setpoints were moved: {moved}")
                checked = checked_with(memory)
        blamed = _blame(guard, memory, reading, checked, rules, mine)
        if blamed is not None:
            memory = blamed
            checked = checked_with(memory)
    if closed and moved:
        trouble = f"setpoints were moved by somebody else: {moved}"
    if trouble and checked.verdict.action < Action.HOLD:
        checked = replace(checked, verdict=Verdict(Action.HOLD, "setpoints", trouble))
    return replace(checked, memory=replace(checked.memory, seen=seen))


def look_for_second(
    checked: Checked,
    reading: Reading,
    rules: Rules,
    mine: Mask,
    closing: bool,
    draw: Callable[[], float],
) -> Checked:
    """Look for a second controller; a loop that neither writes nor waits to may have one.

    Args:
        checked: The orbit as it was looked at so far.
        reading: Tells which setpoints others have put.
        rules: Settings and names.
        mine: Correctors that the loop moves, or would, shape (m,).
        closing: Whether the loop is asked to close.
        draw: Gives a number from 0 to 1 at random.
    """
    state, names = checked.memory.state, rules.channels.correctors
    closed = state is LoopState.CLOSED
    verdict, second = checked.memory.second.look(
        reading.by_others, mine, rules.interlocks, names, closed, draw
    )
    checked = replace(checked, memory=replace(checked.memory, second=second))
    matters = closing or closed or state is LoopState.HELD
    return worse(checked, verdict) if matters else checked


def _blame(
    guard: Guard,
    memory: LoopMemory,
    reading: Reading,
    checked: Checked,
    rules: Rules,
    mine: Mask,
) -> LoopMemory | None:
    """Before the response is called wrong, see whether one corrector explains what is seen.

    Returns:
        The memory of a loop that leaves it out and expects the answer of the others from now on;
        None: there is nothing to explain, or no one that does.
    """
    response = guard.response
    wrong = checked.verdict.action is Action.TRIP and checked.verdict.cause == "prediction"
    if not wrong or response is None or not guard.can_leave_out:
        return None
    orbit = reading.orbit
    index = culprit(orbit.position, checked.valid, memory.answers, response, mine, rules.interlocks)
    if index is None:
        return None
    why = "the orbit does not answer to it as the response matrix says, but to the others"
    found = {**memory.refusals.found, index: why}
    refusals = replace(memory.refusals, found=found)
    return replace(memory, answers=Answers(), growth=Growth(), refusals=refusals)


def _back(memory: LoopMemory, reading: Reading, among: Mask) -> bool:
    """Whether some correctors can be written again."""
    before, away = memory.away, reading.away
    if before is None:
        return False
    back = before & among
    return bool((back if away is None else back & ~away).any())


def _strayed(off: Mask, readback: Vector, seen: Vector | None, rules: Rules) -> tuple[bool, Vector]:
    """Say whether the setpoints of some that are not ours are worth asking for.

    One that is switched off reads something else than its setpoint for good: it is asked for
    once, and again when the readback moves on.

    Args:
        off: Those whose readback is not at their setpoint, shape (m,).
        readback: Shape (m,) [A]; NaN where none is known.
        seen: Readbacks at which they were asked for last, shape (m,) [A].
        rules: Tolerance.

    Returns:
        Whether to ask, and what will have been seen then.
    """
    seen = np.full_like(readback, np.nan) if seen is None else seen
    tolerance = rules.interlocks.readback_tolerance or 0.0
    new = off & np.isfinite(readback) & ~(np.abs(readback - seen) <= tolerance)
    kept = np.where(off, seen, np.nan)
    return bool(new.any()), np.where(new, readback, kept)
