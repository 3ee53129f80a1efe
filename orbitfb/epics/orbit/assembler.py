"""Coherent vectors out of single events: pure bookkeeping on arrays.

Events come one scalar at a time, in any order, doubled, lost or with two ticks interleaved. A
vector is coherent when every connected channel carries a stamp within the window of the newest
one, and each of them is newer than what it contributed to the vector before. No sequence PV is
needed: the assembler counts down the events without which the next vector cannot be complete,
and looks at the stamps only when they have come. That is one subtraction per event, and one look
at all stamps per tick even if a channel is stuck for ever.

A channel that sends nothing during a whole tick in which the others do, or sends with another stamp
than they, strays (`stray_stamps`): one vector is lost, the next ones come without it, until its
stamp is theirs again. More than a few at once are no strays but a torn orbit, and nothing comes;
those that do not count for the loop, as they are masked or disabled, are not waited for.
"""

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Mask
from orbitfb.epics.orbit.snapshot import Snapshot
from orbitfb.epics.orbit.stray_stamps import StrayStamps, common_stamp, difference, outside
from orbitfb.epics.orbit.waiting import Waiting, fresh
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

FOLLOWED = 2
"""Vectors in a row right after which one that is left out must have come to be waited for again: as
many as it was outside of to be left out."""


class Assembler:
    """Says after which event a new coherent vector lies in `records`.

    Args:
        size: Count of channels n.
        window: How far the stamps of one vector may lie apart [s].
        most_left: Channels that count and may be left out; 0: all must send.
        now: Monotonic clock [s].
    """

    def __init__(
        self,
        size: int,
        window: float = 0.0,
        most_left: int = 0,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.records = blank_records(size)
        self.connected: Mask = np.zeros(size, dtype=np.bool_)
        self.checks = 0
        """How often all stamps were looked at."""
        self._window = round(window * NANOSECONDS)
        self._used: NDArray[np.int64] = np.full(size, NEVER, dtype=np.int64)
        self._published = NEVER
        self._most_left = most_left
        self._left: Mask = np.zeros(size, dtype=np.bool_)
        self._left_at = self._used.copy()
        self._agreed = self._left.copy()
        self._follows = self._left.copy()
        self._followed: NDArray[np.int64] = np.zeros(size, dtype=np.int64)
        self._now = now
        self._completed = self._between = np.inf
        self._strays = StrayStamps(size, self._window)
        self._counting: Mask = np.ones(size, dtype=np.bool_)
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
        stamps, here = stamps_of(self.records), self._expected
        back = here & (stamps > NEVER) & (stamps < self._used)
        if 2 * np.count_nonzero(back) <= np.count_nonzero(here):
            return None
        return wall_time(int(stamps[back].max()))

    def begin_anew(self) -> None:
        """Take older stamps than that of the last vector, but none that is here already.

        Call it from any thread, if it is known that the clock of the IOC was set.
        """
        self._anew = stamps_of(self.records)

    @property
    def apart(self) -> float | None:
        """How far the stamps of new readings lie apart [s], if that is why no vector comes.

        Few that are apart from the others are named by `describe`; here there are no others.
        """
        stamps, here = stamps_of(self.records), self._expected
        new = stamps[here]
        if not new.size or not (new > self._used[here]).all():
            return None
        odd = outside(new, common_stamp(new, self._window), self._window)
        if 2 * np.count_nonzero(odd) < new.size:
            return None
        return int(new.max() - new.min()) / NANOSECONDS

    def set_connected(self, index: int, up: bool) -> None:
        """Expect a channel from now on, or expect it no more.

        Nothing becomes complete by this: were the vector completed by the channels that drop out,
        a dying server would leave a last one of a single BPM behind. What a channel said before it
        went away says nothing of a device that comes back: it is not known until it says it anew.
        """
        if not up:
            self.records[index] = (0, INVALID, 0, 0, np.nan)
        self.connected[index] = up
        self._awaited = 1
        if not up and not self.connected.any():
            self._returning, self._patience = True, PATIENCE

    def count(self, counting: Mask) -> None:
        """Say which channels count for the loop: the others are in a vector if they are in time.

        Args:
            counting: Shape (n,).
        """
        self._counting = counting.copy()

    def look(self) -> None:
        """Give up channels that have not come back with the others; call it every few seconds.

        Those that were left out are waited for again if their stamp is that of the others, as it
        is between two ticks, at two looks in a row.

        Channels of an IOC come back in waves. After an outage of all of them no vector is
        complete until those of the last one are back, or until the second look at some of them:
        else the first orbit after a restart would be one of a few BPMs.
        """
        if self._returning and self.connected.any():
            self._patience -= 1
            self._returning = self._patience > 0
            self._awaited = 1
        agrees = self._agrees(stamps_of(self.records))
        self._left &= ~(agrees & self._agreed)
        self._agreed = agrees

    def arrived(self, values: int = 1) -> bool:
        """Count an event; its record has been written to `records` before.

        Args:
            values: Records that it has brought, all of one stamp.

        Returns:
            True exactly when this event completed a new coherent vector: take `snapshot()` now.
        """
        self._awaited -= values
        return (self._awaited <= 0 or self._anew is not None) and self._complete()

    def snapshot(self) -> Snapshot:
        """Copy the vector that `arrived` has announced, before the next event is written."""
        valid = self.connected & self._present & usable(self.records)
        values = np.where(valid, self.records["value"], np.nan)
        return Snapshot(values, valid, self._published, self._reasons())

    def describe(self, names: tuple[str, ...]) -> str:
        """Say what the next vector waits for.

        Args:
            names: The n PVs.
        """
        if (apart := self.apart) is not None:
            window = self._window / NANOSECONDS
            return (
                f"the BPMs stamp themselves: their stamps lie {apart:.3g} s apart, "
                f"epics.stamp_window = {window:g} s allows less; set it as `orbitfb doctor` says"
            )
        return Waiting(
            stamps_of(self.records),
            self.connected.copy(),
            self._used,
            self._published,
            self._window,
            self._returning,
        ).describe(names)

    def _fresh(self, stamps: NDArray[np.int64], newest: int) -> Mask:
        return fresh(stamps, newest, self._used, self._window)

    def _complete(self) -> bool:
        self.checks += 1
        stamps = stamps_of(self.records)
        if self._anew is not None:
            self._used, self._anew, self._published = self._anew, None, NEVER
        self._left &= self.connected
        connected = self._expected
        present = stamps[connected]
        if not present.size:
            self._awaited = 1
            return False
        if self._returning:
            missing = int(np.count_nonzero(self._present & self._counting & ~connected))
            if missing:
                self._awaited = missing
                return False
            self._returning = False
        newest = int(present.max())
        late = connected & ~self._fresh(stamps, newest)
        if late.any() and self._leave_strays(stamps, connected):
            connected = self._expected
            newest = int(stamps[connected].max())
            late = connected & ~self._fresh(stamps, newest)
        if newest == self._published and self._left.any():
            self._follow(stamps, late)
            return False
        if late.any() or newest <= self._published:
            # Each of them must send at least once more, whatever else comes in between.
            excused = late & self._strays.suspects
            late &= ~(excused & self._may_leave(excused))
            self._awaited = max(int(np.count_nonzero(late)), 1)
            return False
        self._published = newest
        self._strays.clear()
        self._followed = np.where(self._follows, self._followed + 1, 0)
        self._follows = np.zeros_like(self._left)
        self._left &= ~(self._agrees(stamps) | (self._followed >= FOLLOWED))
        self._present = self.connected & ~self._left & self._agrees(stamps)
        self._used[self._present] = stamps[self._present]
        self._awaited = int(np.count_nonzero(self._present))
        if self._left.any():
            now = self._now()
            self._between, self._completed = now - self._completed, now
            self._awaited = 1
        return True

    def _follow(self, stamps: NDArray[np.int64], late: Mask) -> None:
        """See which of those left out get the stamp of the vector soon after it was complete.

        They are sent after the others: they were late when their computer was busy or they had just
        connected, and are left out of vectors that do not wait for them. One that is a period late
        gets that stamp, too, but just before the next vector.
        """
        if self._now() - self._completed < self._between / 2:
            self._follows |= self._left & self._agrees(stamps)
        more = bool((self._left & ~self._follows).any())
        self._awaited = 1 if more else max(int(np.count_nonzero(late)), 1)

    @property
    def _expected(self) -> Mask:
        """Channels without which no vector is complete, shape (n,)."""
        here = self.connected & ~self._left
        counting = here & self._counting
        return counting if counting.any() else here

    def _leave_strays(self, stamps: NDArray[np.int64], connected: Mask) -> bool:
        """Expect no more of those that stray; say whether there are any."""
        strays = self._strays.find(stamps, connected, self._published)
        if not strays.any() or not self._may_leave(strays):
            return False
        self._left |= strays
        self._left_at = np.where(strays, stamps, self._left_at)
        self._agreed &= ~strays
        return True

    def _may_leave(self, more: Mask) -> bool:
        """Whether some more channels may be left out: few of those that count."""
        return int(np.count_nonzero((self._left | more) & self._counting)) <= self._most_left

    def _agrees(self, stamps: NDArray[np.int64]) -> Mask:
        """Tell which channels carry the stamp of the last vector, and anew, shape (n,)."""
        return ~outside(stamps, self._published, self._window) & (stamps > self._used)

    def _reasons(self) -> dict[int, str]:
        """Say of connected channels why they are not in the vector, by index."""
        left = self.connected & self._counting & self._left
        if not left.any():
            return {}
        silent = stamps_of(self.records) == self._left_at
        return {
            index: "sends nothing" if silent[index] else difference(int(offset))
            for index, offset in enumerate(self._strays.offsets)
            if left[index]
        }
