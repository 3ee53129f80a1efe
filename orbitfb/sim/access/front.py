"""What stands between the ring and Channel Access; `fast` and `plain` are its two kinds."""

from collections.abc import Callable
from typing import Any, Protocol

from orbitfb.core.signals import Mask, Vector
from orbitfb.sim.access.listening import Sockets
from orbitfb.sim.access.pva import PvaArrays
from orbitfb.sim.access.stamp import Stamp


class Front(Protocol):
    """Serves the PVs of a ring.

    Attributes:
        on_written: Called when setpoints have been written.
        pva: Arrays over pvAccess; None: there are none.
    """

    on_written: Callable[[], None]
    pva: PvaArrays | None

    @property
    def setpoints(self) -> Vector:
        """Setpoints in force, in the order and the units of the layout: a copy."""
        ...

    @property
    def written(self) -> Mask:
        """Setpoints that were written since the last `show`, shape (m,): a copy."""
        ...

    @property
    def busy(self) -> bool:
        """Whether the last orbit is still on its way to the clients' queues."""
        ...

    def show(self, values: Vector, stamp: Stamp) -> None:
        """Publish the readings of a tick, in the order of the layout and in the PVs' units."""
        ...

    def context(self, sockets: Sockets) -> Any:
        """Make the caproto server that serves it."""
        ...
