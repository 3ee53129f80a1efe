"""What the loop does for a borrower in a tick: send within every limit, remember what was sent."""

import numpy as np

from orbitfb.core.errors import MachineError, WriteError
from orbitfb.core.ports import Machine
from orbitfb.core.signals import Applied, LoopState, Mask, Reading, Vector
from orbitfb.loop import memory as remember
from orbitfb.loop.correction.move import AWAY, AWAY_PERIODS
from orbitfb.loop.memory import LoopMemory, Rules
from orbitfb.loop.tick import Checked
from orbitfb.loop.work import Work
from orbitfb.safety.bounds import Bounds
from orbitfb.safety.limits import limit
from orbitfb.safety.refusals import tolerance_of
from orbitfb.safety.verdict import Action, name_some


class Carrying:
    """Writes for a borrower as the loop writes for itself.

    Args:
        machine: The ring.
        memory: Of the loop.
        rules: Limits and names.
        bounds: Where the setpoint of each corrector may be now.
        work: The tick in hand; it takes what is applied.

    Attributes:
        memory: With the setpoints that were sent.
    """

    def __init__(
        self, machine: Machine, memory: LoopMemory, rules: Rules, bounds: Bounds, work: Work
    ) -> None:
        self._machine, self._rules, self._bounds, self._work = machine, rules, bounds, work
        self.memory = memory

    def setpoints(self) -> Vector:
        """Ask the machine for the setpoints in force, shape (m,) [A]."""
        return self._machine.setpoints()

    def write(self, setpoints: Vector, which: Mask) -> Applied:
        """Send setpoints of some correctors: all of them, or none.

        Args:
            setpoints: Shape (m,) [A].
            which: Correctors to put, shape (m,).

        Raises:
            WriteError: A limit does not let them, or the machine refuses.
            MachineError: The setpoints in force are not known.
        """
        before, rules = self.memory.setpoints, self._rules
        if not np.isfinite(before[which]).all():
            before = np.where(which, self._machine.setpoints(), before)
        change = np.where(which, setpoints - before, 0.0)
        names = rules.channels.correctors
        at = np.where(which, before, 0.0)
        limited = limit(change, at, rules.limits, names, self._bounds)
        cut = (1.0 - limited.scale) * np.abs(change).max(initial=0.0)
        if not limited.verdict.may_act or cut > tolerance_of(rules.interlocks):
            most = f"a setpoint may change by {rules.limits.change_per_tick:g} A in a tick"
            raise WriteError(f"nothing was sent: {limited.verdict.reason or most}")
        began = self._work.clock.monotonic()
        try:
            applied = self._machine.write(setpoints, which)
        except MachineError:
            self.memory = remember.forget_setpoints(self.memory)
            raise
        finally:
            self._work.done("act")
        sent, lag = np.where(which, applied.setpoints, before), rules.interlocks.readback_lag
        work = self._work
        self.memory = work.remember_sent(sent, work.setpoints, applied, began, self.memory, lag)
        work.requested = work.applied
        return applied


def trouble_of(
    lent: Mask,
    memory: LoopMemory,
    reading: Reading | None,
    checked: Checked | None,
    rules: Rules,
    mine: Mask,
    now: float,
) -> str:
    """Say why a borrower has to give the machine back; empty: it may go on.

    Args:
        lent: Correctors that are lent, shape (m,).
        memory: Of the loop.
        reading: The orbit of this tick; None: there is none.
        checked: The same, looked at as if the loop were to close.
        rules: Pacing and names.
        mine: Correctors that the loop would move, shape (m,).
        now: Monotonic [s].
    """
    names = rules.channels.correctors
    if memory.state is not LoopState.OPEN:
        return f"the loop is {memory.state}; setpoints are moved for others while it is OPEN"
    if reading is not None and reading.away is not None and (away := reading.away & lent).any():
        return f"{name_some(away, names)} cannot be written any more"
    if checked is not None and checked.verdict.action > Action.SKIP:
        return checked.verdict.reason
    if (foreign := lent & ~mine).any():
        return f"the loop does not move {name_some(foreign, names)}"
    if (silent := now - memory.fresh) > max(AWAY, AWAY_PERIODS * rules.loop.period):
        why = f": {checked.verdict.reason}" if checked and checked.verdict.reason else ""
        return f"no orbit to act on came for {silent:.2g} s{why}"
    return ""
