"""Coherent vectors out of single events: pure bookkeeping on arrays.

Events come one scalar at a time, in any order, doubled, lost or with two ticks interleaved. A
vector is coherent when every connected channel carries a stamp within the window of the newest
one, and each of them is newer than what it contributed to the vector before. No sequence PV is
needed: the assembler counts down the events without which the next vector cannot be complete,
and looks at the stamps only when they have come. That is one subtraction per event, and one look
at all stamps per tick even if a channel is stuck for ever.

A channel that sends nothing during a whole tick in which the others do is stuck: one vector is
lost, the next ones come without it, until it sends again. More than a few at once are no channels
that are stuck but a torn orbit, and nothing comes.
"""

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Mask, Vector
from orbitfb.epics.records import (
    INVALID,
    NANOSECONDS,
    blank_records,
    stamps_of,
    usable,
    wall_time,
)

NEVER = 0
"""Stamp of a record that nothing has been written to: less than any that comes."""


PATIENCE = 2
"""Looks at channels coming back before the rest is given up."""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """One coherent vector.

    Args:
        values: Shape (n,), in the unit of the PVs; NaN where not valid.
        valid: Shape (n,); False where disconnected, INVALID or not finite.
        stamp: Newest stamp in it [ns since the EPICS epoch].
    """

    values: Vector
    valid: Mask
    stamp: int

    @property
    def time(self) -> float:
        """The stamp [s since the epoch]."""
        return wall_time(self.stamp)


class Assembler:
    """Says after which event a new coherent vector lies in `records`.

    Args:
        size: Count of channels n.
        window: How far the stamps of one vector may lie apart [s].
        most_stuck: Channels that may be stuck; 0: all must send.
    """

    def __init__(self, size: int, window: float = 0.0, most_stuck: int = 0) -> None:
        self.records = blank_records(size)
        self.connected: Mask = np.zeros(size, dtype=np.bool_)
        self.checks = 0
        """How often all stamps were looked at."""
        self._window = round(window * NANOSECONDS)
        self._used: NDArray[np.int64] = np.full(size, NEVER, dtype=np.int64)
        self._published = NEVER
        self._most_stuck = most_stuck
        self._stuck: Mask = np.zeros(size, dtype=np.bool_)
        self._stuck_at = self._used.copy()
        self._present: Mask = np.zeros(size, dtype=np.bool_)
        self._returning = False
        self._patience = PATIENCE
        self._awaited = 1
        self._anew: NDArray[np.int64] | None = None

    @property
    def went_back(self) -> float | None:
        """Newest stamp of those that went back [s since the epoch], if most channels did.

        A channel went back if it says something older than what it gave to the last vector. Then
        no vector comes until the clock has caught up, or `begin_anew` was called.
        """
        stamps, here = stamps_of(self.records), self.connected & ~self._stuck
        back = here & (stamps > NEVER) & (stamps < self._used)
        if 2 * np.count_nonzero(back) <= np.count_nonzero(here):
            return None
        return wall_time(int(stamps[back].max()))

    def begin_anew(self) -> None:
        """Take older stamps than that of the last vector, but none that is here already.

        Call it from any thread, if it is known that the clock of the IOC was set.
        """
        self._anew = stamps_of(self.records)

    def set_connected(self, index: int, up: bool) -> None:
        """Expect a channel from now on, or expect it no more.

        Nothing becomes complete by this: were the vector completed by the channels that drop out,
        a dying server would leave a last one of a single BPM behind. What a channel said before it
        went away says nothing of a device that comes back: it is not known until it says it anew.
        """
        if not up:
            self.records["severity"][index] = INVALID
        self.connected[index] = up
        self._awaited = 1
        if not up and not self.connected.any():
            self._returning, self._patience = True, PATIENCE

    def look(self) -> None:
        """Give up channels that have not come back with the others; call it every few seconds.

        Channels of an IOC come back in waves. After an outage of all of them no vector is
        complete until those of the last one are back, or until the second look at some of them:
        else the first orbit after a restart would be one of a few BPMs.
        """
        if self._returning and self.connected.any():
            self._patience -= 1
            self._returning = self._patience > 0
            self._awaited = 1

    def arrived(self) -> bool:
        """Count an event; its record has been written to `records` before.

        Returns:
            True exactly when this event completed a new coherent vector: take `snapshot()` now.
        """
        self._awaited -= 1
        return (self._awaited <= 0 or self._anew is not None) and self._complete()

    def snapshot(self) -> Snapshot:
        """Copy the vector that `arrived` has announced, before the next event is written."""
        valid = self.connected & ~self._stuck & usable(self.records)
        return Snapshot(np.where(valid, self.records["value"], np.nan), valid, self._published)

    def describe(self, names: tuple[str, ...]) -> str:
        """Say what the next vector waits for.

        Args:
            names: The n PVs.
        """
        connected = self.connected.copy()
        total, present = connected.size, int(np.count_nonzero(connected))
        if not present:
            return f"all {total} BPM channels are disconnected"
        away = f"; {total - present} disconnected" if present < total else ""
        if self._returning:
            return (
                f"{present} of {total} BPMs are back after an outage of all; waiting for the rest"
            )
        stamps = stamps_of(self.records)
        newest = int(stamps[connected].max())
        if newest <= 0:
            return f"none of {present} connected BPMs has sent a reading{away}"
        if newest < self._published:
            return (
                f"stamps went back from {_clock(self._published)} to {_clock(newest)}: "
                f"the IOC's clock was set{away}"
            )
        late = connected & ~self._fresh(stamps, newest)
        count = int(np.count_nonzero(late))
        if count == present or newest == self._published:
            return (
                f"{present} of {total} BPMs still carry stamp {_clock(newest)}, read before{away}"
            )
        shown = ", ".join(
            f"{names[i]} still at {_clock(int(stamps[i]))}" for i in np.flatnonzero(late)[:5]
        )
        more = f" and {count - 5} more" if count > 5 else ""
        return (
            f"{present - count} of {total} BPMs carry stamp {_clock(newest)}, {shown}{more}{away}"
        )

    def _fresh(self, stamps: NDArray[np.int64], newest: int) -> Mask:
        return (stamps >= newest - self._window) & (stamps > self._used)

    def _complete(self) -> bool:
        self.checks += 1
        stamps = stamps_of(self.records)
        if self._anew is not None:
            self._used, self._anew, self._published = self._anew, None, NEVER
        if self._stuck.any():
            self._stuck &= self.connected & (stamps == self._stuck_at)
        connected = self.connected & ~self._stuck
        present = stamps[connected]
        if not present.size:
            self._awaited = 1
            return False
        if self._returning:
            missing = int(np.count_nonzero(self._present & ~connected))
            if missing:
                self._awaited = missing
                return False
            self._returning = False
        newest = int(present.max())
        late = int(np.count_nonzero(connected & ~self._fresh(stamps, newest)))
        if late and self._most_stuck and self._give_up(stamps, connected):
            connected = self.connected & ~self._stuck
            present = stamps[connected]
            late = int(np.count_nonzero(connected & ~self._fresh(stamps, newest)))
        if late or newest <= self._published:
            # Each of them must send at least once more, whatever else comes in between.
            self._awaited = max(late, 1)
            return False
        self._published = newest
        self._used[connected] = present
        self._present = connected.copy()
        self._awaited = present.size
        return True

    def _give_up(self, stamps: NDArray[np.int64], connected: Mask) -> bool:
        """Expect no more of those that were silent for a whole tick; say whether there are any."""
        silent = connected & (stamps <= self._used)
        count = int(np.count_nonzero(silent))
        sent = stamps[connected & ~silent]
        most = min(self._most_stuck - int(np.count_nonzero(self._stuck)), len(sent) - 1)
        # Two ticks are under way: the silent ones have left out the first of them altogether.
        if not 0 < count <= most or int(sent.max()) - int(sent.min()) <= self._window:
            return False
        if int(sent.min()) <= self._published:
            return False
        self._stuck |= silent
        self._stuck_at = np.where(silent, stamps, self._stuck_at)
        return True


def _clock(stamp: int) -> str:
    if stamp <= 0:
        return "none"
    return datetime.fromtimestamp(wall_time(stamp), UTC).isoformat(timespec="milliseconds")
