"""A closed loop waits while its last change is still on the way: one error is corrected once."""

from dataclasses import replace

from orbitfb.core.signals import Reading
from orbitfb.loop import memory as remember
from orbitfb.loop.memory import LoopMemory
from orbitfb.loop.tick import Checked
from orbitfb.safety.arrival import arrived


def wait_for_change(
    memory: LoopMemory, reading: Reading, checked: Checked
) -> tuple[bool, LoopMemory]:
    """Say whether to write nothing at this tick, as its orbit does not know of the last change.

    Args:
        memory: Of a loop that is CLOSED.
        reading: The orbit, with its readbacks.
        checked: The same.
    """
    follows = ~memory.lost if reading.away is None else ~memory.lost & ~reading.away
    part, sent = arrived(reading.readback, memory.setpoints, follows, memory.sent)
    memory = replace(memory, sent=sent)
    if part is None:
        return False, memory
    told = (
        f"held back: {max(part, 0.0):.0%} of the last change shows in the readbacks of this orbit"
    )
    reason = "; ".join(filter(None, (checked.verdict.reason, told)))
    return True, remember.note(memory, reason, may_act=True)
