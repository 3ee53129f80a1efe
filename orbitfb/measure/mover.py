"""Moves setpoints around where they were found, in limited steps, and puts them back."""

from collections.abc import Sequence

import numpy as np

from orbitfb.core.errors import AwayError, MachineError, MeasurementError, NoOrbitError
from orbitfb.core.ports import Clock, Machine
from orbitfb.core.signals import Mask, Vector
from orbitfb.measure.watch import Watch
from orbitfb.safety.bounds import Bounds
from orbitfb.safety.limits import LimitSettings, limit
from orbitfb.safety.verdict import name_some


class Mover:
    """Moves setpoints, relative to those that it found.

    Args:
        machine: The ring.
        limits: Of every write.
        watch: Gives the orbit between two writes.
        same: Difference up to which a setpoint is the one that was sent [A].

    Attributes:
        base: Setpoints that were found, shape (m,) [A].
        astray: Correctors that the last `restore` could not bring back, as indices.

    Raises:
        MachineError: The setpoints cannot be read.
    """

    def __init__(
        self,
        machine: Machine,
        limits: LimitSettings,
        watch: Watch,
        same: float,
        bounds: Bounds | None = None,
    ) -> None:
        self._machine, self._limits, self._watch, self._same = machine, limits, watch, same
        self._bounds = bounds
        self.base = machine.setpoints()
        self._sent = self.base.copy()
        self.astray: Sequence[int] = ()

    def verify(self) -> None:
        """See that the setpoints are where they were put.

        Raises:
            MeasurementError: Somebody else moved some, or the machine did not take them.
        """
        present = self._machine.setpoints()
        moved = ~(np.abs(present - self._sent) <= self._same)
        if moved.any():
            names = name_some(moved, self._machine.channels.setpoint_pvs)
            raise MeasurementError(
                f"{np.count_nonzero(moved)} setpoints are not where they were found or put: "
                f"{names}; somebody else moves them (a closed loop, an operator), or the machine "
                "refuses them"
            )

    def offset(self, correctors: Sequence[int], offsets: Vector) -> None:
        """Move some correctors away from their base, in as many steps as the limits ask for.

        Args:
            correctors: Their indices.
            offsets: From their base, shape (k,) [A].

        Raises:
            MeasurementError: A limit does not let them, somebody else moves setpoints, or the
                measurement must be given up.
            WriteError: The machine does not take it.
        """
        self.verify()
        target = self._sent.copy()
        target[list(correctors)] = self.base[list(correctors)] + offsets
        while not self._step(target, correctors):
            self._watch.orbit()
            self.verify()

    def _step(self, target: Vector, correctors: Sequence[int]) -> bool:
        """Go one step with some correctors; says whether this was the last one."""
        names = self._machine.channels.setpoint_pvs
        limited = limit(target - self._sent, self._sent, self._limits, names, self._bounds)
        if not limited.verdict.may_act or limited.scale == 0.0:
            raise MeasurementError(limited.verdict.reason)
        arrived = limited.scale == 1.0
        which = np.zeros(len(target), dtype=np.bool_)
        which[list(correctors)] = True
        wanted = target if arrived else limited.setpoints
        self._sent = self._machine.write(wanted, which).setpoints.copy()
        return arrived

    def restore(self, correctors: Sequence[int]) -> None:
        """Bring some correctors back to their base; others stay as they are now.

        One that cannot be brought back keeps none of the others from it.

        Args:
            correctors: Their indices.

        Raises:
            MachineError: Some are not back, or it is not known; `astray` has them.
        """
        mine = list(correctors)
        self.astray = mine
        expected = self._sent.copy()
        expected[mine] = self.base[mine]
        self._sent, away = self._present()
        there = [j for j in mine if not away[j]]
        problem = self._bring(there)
        for j in there if problem else ():
            problem = self._bring([j]) or problem
        present, away = self._present()
        apart = away | ~(np.abs(present - self.base) <= self._same)
        self.astray = [j for j in mine if apart[j]]
        if self.astray:
            names = name_some(apart, self._machine.channels.setpoint_pvs)
            raise MachineError(problem or f"{names} do not read back what was put, or are away")
        self._sent = expected  # what somebody else moved meanwhile is still to be seen

    def _present(self) -> tuple[Vector, Mask]:
        """Ask for the setpoints, shape (m,) [A], and say which are away and only last known."""
        try:
            present = self._machine.setpoints()
        except AwayError as error:
            return error.last.copy(), error.away
        return present, np.zeros(len(present), dtype=np.bool_)

    def _bring(self, correctors: Sequence[int]) -> str:
        """Bring some correctors to their base in limited steps; says what kept it from that."""
        target = self._sent.copy()
        target[list(correctors)] = self.base[list(correctors)]
        try:
            while not self._step(target, correctors):
                self._machine.read(1.0)  # a step per orbit
        except (MachineError, MeasurementError) as error:
            return str(error)
        return ""


def restore_persistently(
    mover: Mover, correctors: Sequence[int], machine: Machine, clock: Clock, patience: float
) -> None:
    """Try again and again to bring correctors back.

    Args:
        mover: Knows their base.
        correctors: Their indices.
        machine: The ring; reading it is how time passes.
        clock: Tells how much.
        patience: How long to try [s].

    Raises:
        MeasurementError: They could not be brought back; the message names them.
    """
    begin = clock.monotonic()
    while True:
        try:
            mover.restore(correctors)
        except MachineError as error:
            problem = str(error)
        else:
            return
        if clock.monotonic() - begin >= patience:
            break
        try:
            machine.read(0.5)
        except NoOrbitError:
            continue
    names, left = machine.channels.setpoint_pvs, list(mover.astray)
    told = ", ".join(f"{names[j]} to {mover.base[j]:.6g} A" for j in left[:5])
    more = f" and {len(left) - 5} more" if len(left) > 5 else ""
    raise MeasurementError(
        f"{len(left)} setpoints could NOT be put back within {patience:g} s ({problem}): "
        f"{told}{more}; start the measurement again: it offers to put them back"
    )
