"""What the machine says its setpoints are, and what of it the loop may believe."""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.errors import AwayError, MachineError
from orbitfb.core.ports import Machine
from orbitfb.core.signals import Mask, Vector
from orbitfb.loop import memory as remember
from orbitfb.loop.memory import LoopMemory, Rules
from orbitfb.safety.refusals import closely, tolerance_of
from orbitfb.safety.verdict import name_some


@dataclass(frozen=True, slots=True)
class Answer:
    """What became of the question.

    Args:
        memory: With the setpoints that are in force, or none where they are not known.
        trouble: What failed; empty when nothing did.
        other: Correctors of ours whose setpoint is not as believed, shape (m,); None: not known.
        moved: The first of them that somebody moved, for all one knows; empty when none was.
        known: Whether the setpoints are known.
    """

    memory: LoopMemory
    trouble: str = ""
    other: Mask | None = None
    moved: str = ""
    known: bool = True


def ask_setpoints(
    machine: Machine,
    memory: LoopMemory,
    rules: Rules,
    away: Mask | None,
    response: Vector | None = None,
) -> Answer:
    """Have the machine state its setpoints.

    Those that are known to be away, or are not ours, are left out of the loop: what they were
    will do.

    Args:
        machine: To ask.
        memory: So far.
        rules: Tolerance and names.
        away: Correctors that cannot be written now, shape (m,); None: none.
        response: R, shape (n, m) [m/A], if it is about to be called wrong: one setpoint that is
            off by little might explain that; None: it is not.
    """
    try:
        actual = np.array(machine.setpoints(), dtype=np.float64)
    except AwayError as error:
        actual = error.last
        needed = error.away if away is None else error.away & ~away
        if (needed if memory.mine is None else needed & memory.mine).any():
            return _unknown(memory, error)
    except MachineError as error:
        return _unknown(memory, error)
    tolerance: float | Vector = tolerance_of(rules.interlocks)
    if response is not None:
        close = closely(actual - memory.setpoints, response, rules.interlocks)
        tolerance = np.minimum(tolerance, close)
    mask = remember.moved(memory, actual, tolerance)
    memory = remember.confirm_setpoints(memory, actual, tolerance)
    if not np.isfinite(actual).all():
        return Answer(memory, "the machine states setpoints that are not finite")
    return Answer(memory, other=mask, moved=name_some(mask, rules.channels.correctors))


def _unknown(memory: LoopMemory, error: MachineError) -> Answer:
    trouble = f"the setpoints in force are not known: {error}"
    return Answer(remember.forget_setpoints(memory), trouble, known=False)
