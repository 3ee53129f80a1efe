"""One coherent vector of readings."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from orbitfb.core.signals import Mask, Vector
from orbitfb.epics.records import wall_time


@dataclass(frozen=True, slots=True)
class Snapshot:
    """One coherent vector.

    Args:
        values: Shape (n,), in the unit of the PVs; NaN where not valid.
        valid: Shape (n,); False where disconnected, INVALID or not finite.
        stamp: Newest stamp in it [ns since the EPICS epoch].
        left_out: Why connected channels are not in it, by index.
    """

    values: Vector
    valid: Mask
    stamp: int
    left_out: Mapping[int, str] = field(default_factory=dict[int, str])

    @property
    def time(self) -> float:
        """The stamp [s since the epoch]."""
        return wall_time(self.stamp)
