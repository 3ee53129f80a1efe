"""Prebuilt monitor updates: one block of bytes per client and tick.

An update is an EVENT_ADD response of the Channel Access protocol: a header of 16 bytes (command,
payload size, type, count, status, subscription id), 16 bytes of alarm and stamp or none, and 8
bytes of each value, everything big-endian and in whole words of 8 bytes. The headers never change,
so that a tick only fills values, stamps and alarms into a copy of the words and sends it in one
write.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Mask
from orbitfb.sim.access.board import Board

DOUBLE, TIME_DOUBLE = 6, 20
_EVENT_ADD = 1
_NORMAL = 1
_STAMP_WORDS = {DOUBLE: 0, TIME_DOUBLE: 2}
_HEADER_WORDS = 2
UPDATE_SIZE = 8 * (_HEADER_WORDS + _STAMP_WORDS[TIME_DOUBLE] + 1)
"""Length of a time-stamped update of a scalar [bytes]."""
_STAMP_ALONE = np.uint64(0xFFFFFFFF)
"""Of the first word of a stamp: without the alarm, which is of one device and not of an array."""
LONGEST = 0xFFFF // 8 - _STAMP_WORDS[TIME_DOUBLE]
"""Values of the longest array whose size the short header can tell."""
NOWHERE: NDArray[np.intp] = np.zeros(0, dtype=np.intp)


@dataclass(frozen=True, slots=True, eq=False)
class Monitor:
    """One subscription of one client.

    Args:
        places: Its values, indices of the board, shape (k,).
        subscription: The client's number for it.
        channel: The server's number of the channel that it is on.
        data_type: DOUBLE or TIME_DOUBLE.
    """

    places: NDArray[np.intp]
    subscription: int
    channel: int
    data_type: int

    @property
    def words(self) -> int:
        """Length of its update in words of 8 bytes."""
        return _HEADER_WORDS + _STAMP_WORDS[self.data_type] + len(self.places)


class Frames:
    """The updates of one client's monitors, in the order of the board.

    Args:
        monitors: Any number, in any order.
    """

    def __init__(self, monitors: Sequence[Monitor]) -> None:
        ordered = sorted(monitors, key=lambda monitor: int(monitor.places[0]))
        lengths = np.array([m.words for m in ordered], dtype=np.intp)
        ends = np.cumsum(lengths, dtype=np.intp)
        self._spans = list(zip((ends - lengths).tolist(), ends.tolist(), strict=True))
        self._words = np.zeros(int(ends[-1]) if ordered else 0, dtype=">u8")
        self._values = self._words.view(">f8")
        sizes = np.array([len(m.places) for m in ordered], dtype=np.intp)
        self._begins = np.cumsum(sizes) - sizes
        self._places = np.concatenate([NOWHERE, *(m.places for m in ordered)])
        first = ends - sizes  # where the values of each begin
        self._value_at = np.repeat(first - self._begins, sizes) + np.arange(len(self._places))
        timed = np.array([m.data_type == TIME_DOUBLE for m in ordered], dtype=np.bool_)
        self._timed = self._places[self._begins[timed]]
        self._head_at, self._tail_at = first[timed] - 2, first[timed] - 1
        self._kept = np.where(sizes[timed] > 1, _STAMP_ALONE, ~np.uint64(0))
        for monitor, (start, end) in zip(ordered, self._spans, strict=True):
            size, count = (end - start - _HEADER_WORDS) * 8, len(monitor.places)
            self._words[start] = _EVENT_ADD << 48 | size << 32 | monitor.data_type << 16 | count
            self._words[start + 1] = _NORMAL << 32 | monitor.subscription

    def __len__(self) -> int:
        return len(self._spans)

    def fill(self, board: Board) -> None:
        """Take the present values, stamps and alarms from the board."""
        self._values[self._value_at] = board.value[self._places]
        self._words[self._head_at] = board.head[self._timed] & self._kept
        self._words[self._tail_at] = board.tail[self._timed]

    def rows(self, which: Mask) -> NDArray[np.intp]:
        """Give the monitors that show any of some values.

        Args:
            which: Values of the board, shape (readings + setpoints,).
        """
        if not len(self):
            return NOWHERE
        return np.flatnonzero(np.logical_or.reduceat(which[self._places], self._begins))

    def whole(self) -> bytes:
        """Give all updates as one block."""
        return self._words.tobytes()

    def part(self, rows: NDArray[np.intp]) -> bytes:
        """Give the updates of some monitors, by their number, as one block."""
        if len(rows) == len(self):
            return self.whole()
        spans = (self._spans[row] for row in rows)
        return b"".join(self._words[start:end].tobytes() for start, end in spans)
