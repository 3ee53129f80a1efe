"""A closed loop waits while its last change is still on the way: one error is corrected once.

It waits for as many ticks as a readback may lag; then it asks the machine for its setpoints, whose
answer comes behind the change, and goes on from what they are: a change may have been lost.
"""

from collections.abc import Callable

import numpy as np

from orbitfb.core.signals import Mask, Reading
from orbitfb.core.values import replace
from orbitfb.loop import memory as remember
from orbitfb.loop.memory import LoopMemory, Rules
from orbitfb.loop.tick import Checked
from orbitfb.safety.arrival import RARE, SEEN, acted, arrived


def wait_for_change(
    memory: LoopMemory,
    reading: Reading,
    checked: Checked,
    rules: Rules,
    mine: Mask,
    ask: Callable[[], tuple[LoopMemory, str]],
) -> tuple[bool, LoopMemory, str]:
    """Say whether to write nothing at this tick, as its orbit does not know of the last change.

    Args:
        memory: Of a loop that is CLOSED.
        reading: The orbit, with its readbacks.
        checked: The same.
        rules: Say by how many ticks a readback may lag behind its setpoint.
        mine: Correctors that the loop moves, shape (m,): where the others are tells nothing.
        ask: Asks for the setpoints in force; gives what is wrong with them.

    Returns:
        Whether to write nothing, the memory, and what keeps the loop from going on.
    """
    usual = memory.sent.late >= RARE
    part, sent = arrived(reading.readback, memory.setpoints, _tells(reading, mine), memory.sent)
    if part is not None and usual and _acted(memory, checked, rules):
        part, sent = None, replace(sent, change=None, waited=0)
    memory = replace(memory, sent=sent)
    if part is None:
        return False, memory, ""
    told = (
        f"held back: {max(part, 0.0):.0%} of the last change shows in the readbacks of this orbit"
    )
    reason = "; ".join(filter(None, (checked.verdict.reason, told)))
    trouble = ""
    if sent.waited > rules.interlocks.readback_lag:
        memory, trouble = ask()
        memory = replace(memory, sent=replace(sent, change=None, waited=0))
    return True, remember.note(memory, reason, may_act=True), trouble


def too_early(memory: LoopMemory, reading: Reading, mine: Mask) -> bool:
    """Say whether an orbit was taken before the last change acted, at a machine that is in time.

    Such an orbit answers nothing yet: whether the ring answers is asked of the next.

    Args:
        memory: Of a loop that is CLOSED.
        reading: The orbit, with its readbacks.
        mine: Correctors that the loop moves, shape (m,).
    """
    if memory.sent.late >= RARE:
        return False
    part, _ = arrived(reading.readback, memory.setpoints, _tells(reading, mine), memory.sent)
    return part is not None


def _tells(reading: Reading, mine: Mask) -> Mask:
    """Find the correctors whose readbacks tell whether a change has acted, shape (m,)."""
    tells = mine
    for mask in (reading.away, reading.behind):
        tells = tells if mask is None else tells & ~mask
    return tells


def _acted(memory: LoopMemory, checked: Checked, rules: Rules) -> bool:
    """Whether the orbit shows the last change, whatever the readbacks say."""
    answers, ago = memory.answers, memory.sent.waited
    if answers.step is None or len(answers.predicted) <= ago:
        return False
    step = np.where(checked.valid, answers.step, np.nan)
    part = acted(step, answers.predicted[ago], rules.interlocks.prediction_floor)
    return part is not None and part >= SEEN
