"""What a soft IOC says once clients can connect."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Served:
    """Where a soft IOC is found.

    Args:
        port: Of Channel Access, TCP and UDP.
        pvs: Count of PVs.
        pva_port: Where searches over pvAccess come (UDP); 0: nothing is served over it.
    """

    port: int
    pvs: int
    pva_port: int = 0


Announce = Callable[[Served], None]
