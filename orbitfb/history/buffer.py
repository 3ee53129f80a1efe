"""The last ticks in memory: one thread writes, any other takes a consistent copy at any time.

No lock, so the writer never waits. Row k of all time lives in slot k modulo the number of
slots. The writer counts the rows it has *begun* before it touches a slot and those it has
*done* after. A reader looks at `done`, copies the rows before it, and only then looks at
`begun`: a row k it copied can have been touched meanwhile only if row k + slots was begun, so
everything below begun − slots is dropped and the rest is whole. Nothing is retried: whoever is
slow gets fewer old rows, never torn ones, and the slots kept beyond `capacity` make that rare.

Under the GIL both counters and all copies happen in one order for everybody; a copy that numpy
makes with the GIL released is covered by the check after it. Without a GIL a processor might
show the reader data before the counter that announces them: what stands against it is that the
reader drops a few rows more than it must, and that no store stays out of sight for the length
of a tick.
"""

from collections.abc import Iterable

import numpy as np

from orbitfb.core.signals import Channels, TickRecord
from orbitfb.core.transitions import Transitions
from orbitfb.history.columns import AUXILIARY, allocate, fill, layout, transitions_of

_SPARE = 64
_MARGIN = 4


class History:
    """The last `capacity` ticks; a subscriber of the loop.

    Args:
        channels: The names behind the vectors.
        capacity: How many ticks are kept [rows].
    """

    def __init__(self, channels: Channels, capacity: int) -> None:
        self.channels = channels
        self.capacity = capacity
        self._slots = capacity + _SPARE
        self._columns = allocate(layout(channels), self._slots)
        self._begun = 0
        self._done = 0

    def __len__(self) -> int:
        return min(self._done, self.capacity)

    def __call__(self, record: TickRecord) -> None:
        """Keep a record. Only the loop's thread may call this."""
        if record.reading is not None:
            self._make_room(record.reading.auxiliary)
        row = self._done
        self._begun = row + 1
        fill(self._columns, row % self._slots, record)
        self._done = row + 1

    def snapshot(self, last: int | None = None, since_tick: int | None = None) -> Transitions:
        """Copy the transitions of the ticks that are kept.

        Args:
            last: At most that many, the latest ones.
            since_tick: Only those that begin at this tick or later.

        Returns:
            Transitions that later ticks do not change, the oldest first; possibly none.
        """
        columns = self._columns
        end = self._done
        kept = self.capacity if last is None else min(self.capacity, last + 1)
        start = max(0, end - kept)
        if since_tick is not None:
            ticks = columns["tick"][np.arange(start, end) % self._slots]
            start += int(np.count_nonzero(ticks < since_tick))
        slots = np.arange(start, end) % self._slots
        copied = {name: np.take(column, slots, axis=0) for name, column in columns.items()}
        torn = self._begun - self._slots + _MARGIN
        if torn > start:
            copied = {name: column[torn - start :] for name, column in copied.items()}
        return transitions_of(copied)

    def _make_room(self, names: Iterable[str]) -> None:
        """Add a column for each slow channel that is seen for the first time."""
        fresh = [name for name in names if AUXILIARY + name not in self._columns]
        if fresh:
            # A new dictionary, so that a reader's loop over the old one is not disturbed.
            self._columns = self._columns | {
                AUXILIARY + name: np.full(self._slots, np.nan) for name in fresh
            }
