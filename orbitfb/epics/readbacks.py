"""Readbacks of the correctors, and what stands for one where a corrector has none."""

from collections.abc import Callable

import numpy as np

from orbitfb.core.signals import Channels, Mask, Vector
from orbitfb.epics.channels import ChannelGroup
from orbitfb.epics.events import Monitor
from orbitfb.epics.inbox import Frame
from orbitfb.epics.libca import Context
from orbitfb.epics.orbit.assembler import Assembler


class Readbacks:
    """Readbacks that go with an orbit.

    Args:
        channels: Names of the PVs; a readback without a name is none.
        stamp_window: Largest distance of two stamps of one tick [s].

    Attributes:
        assembler: Collects those of a tick.
    """

    def __init__(self, channels: Channels, stamp_window: float) -> None:
        self._names = channels.readback_pvs
        self._have: Mask = np.array([bool(name) for name in self._names], dtype=np.bool_)
        self.assembler = Assembler(int(np.count_nonzero(self._have)), stamp_window)

    def group(self, context: Context, complete: Callable[[], None]) -> ChannelGroup:
        """Make their channels.

        Args:
            context: Of the channels.
            complete: Told when those of a tick are there.
        """
        assembler = self.assembler
        return ChannelGroup(
            context,
            tuple(filter(None, self._names)),
            Monitor(assembler.records, assembler.arrived, complete),
            assembler.set_connected,
            properties=True,
        )

    def complete(self, frame: Frame, posted: Vector) -> tuple[Vector, Mask | None]:
        """Put the setpoint, as the machine posts it, where a corrector has no readback.

        It tells that the put arrived, and nothing of what the supply does: it counts as older than
        the orbit.

        Args:
            frame: An orbit, and the readbacks that there are.
            posted: Setpoints, shape (m,) [A].

        Returns:
            A value for each corrector, shape (m,) [A], and which are older than the orbit, shape
            (m,); None: none is.
        """
        have, behind = self._have, frame.behind
        if have.all():
            return frame.readback, behind
        readback = posted.copy()
        readback[have] = frame.readback
        older = ~have
        if behind is not None:
            older[have] = behind
        return readback, older
