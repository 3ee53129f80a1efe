"""What the next coherent orbit waits for, in words."""

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Mask
from orbitfb.epics.orbit.stray_stamps import common_stamp, difference, outside
from orbitfb.epics.records import wall_time

_SHOWN = 5
"""Channels that are named; more are counted."""


def fresh(stamps: NDArray[np.int64], newest: int, used: NDArray[np.int64], window: int) -> Mask:
    """Tell which channels have sent for the next vector, shape (n,).

    Args:
        stamps: Of all channels, shape (n,) [ns].
        newest: The newest of them [ns].
        used: Stamps in the last vector, shape (n,) [ns].
        window: How far the stamps of one vector may lie apart [ns].
    """
    return (stamps >= newest - window) & (stamps > used)


@dataclass(frozen=True, slots=True)
class Waiting:
    """An incomplete vector.

    Args:
        stamps: Of all channels, shape (n,) [ns since the EPICS epoch].
        connected: Channels that are there, shape (n,).
        used: Stamps in the last vector, shape (n,) [ns].
        published: Stamp of the last vector [ns].
        window: How far the stamps of one vector may lie apart [ns].
        returning: Whether all channels were away, and not all are back.
    """

    stamps: NDArray[np.int64]
    connected: Mask
    used: NDArray[np.int64]
    published: int
    window: int
    returning: bool

    def describe(self, names: tuple[str, ...]) -> str:
        """Say what it waits for.

        Args:
            names: The n PVs.
        """
        total, present = self.connected.size, int(np.count_nonzero(self.connected))
        if not present:
            return f"all {total} BPM channels are disconnected"
        away = f"; {total - present} disconnected" if present < total else ""
        if self.returning:
            return (
                f"{present} of {total} BPMs are back after an outage of all; waiting for the rest"
            )
        newest = int(self.stamps[self.connected].max())
        if newest <= 0:
            return f"none of {present} connected BPMs has sent a reading{away}"
        if newest < self.published:
            return (
                f"stamps went back from {_clock(self.published)} to {_clock(newest)}: "
                f"the IOC's clock was set{away}"
            )
        return f"{self._late(names, newest)}{away}"

    def _late(self, names: tuple[str, ...], newest: int) -> str:
        """Name channels whose stamps are not those of the others."""
        stamps, connected = self.stamps, self.connected
        total, present = connected.size, int(np.count_nonzero(connected))
        common = common_stamp(stamps[connected], self.window)
        odd = connected & outside(stamps, common, self.window)
        if newest > common > self.published and 2 * np.count_nonzero(odd) < present:
            others = present - np.count_nonzero(odd)
            shown = ", ".join(
                f"{names[i]} {difference(int(stamps[i]) - common)}"
                for i in np.flatnonzero(odd)[:_SHOWN]
            )
            return f"{others} of {total} BPMs carry stamp {_clock(common)}, {shown}"
        late = connected & ~fresh(stamps, newest, self.used, self.window)
        count = int(np.count_nonzero(late))
        if count == present or newest == self.published:
            return f"{present} of {total} BPMs still carry stamp {_clock(newest)}, read before"
        shown = ", ".join(
            f"{names[i]} still at {_clock(int(stamps[i]))}" for i in np.flatnonzero(late)[:_SHOWN]
        )
        more = f" and {count - _SHOWN} more" if count > _SHOWN else ""
        return f"{present - count} of {total} BPMs carry stamp {_clock(newest)}, {shown}{more}"


def _clock(stamp: int) -> str:
    if stamp <= 0:
        return "none"
    return datetime.fromtimestamp(wall_time(stamp), UTC).isoformat(timespec="milliseconds")
