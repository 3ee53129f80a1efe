"""Prebuilt monitor updates: one block of bytes per client and tick.

An update of a scalar double is an EVENT_ADD response of the Channel Access protocol: a header of
16 bytes (command, payload size, type, count, status, subscription id) and 8 or 24 bytes of
payload, everything big-endian and in whole words of 8 bytes. The headers never change, so that a
tick only fills values, stamps and alarms into a copy of the words and sends it in one write.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orbitfb.sim.access.board import Board

DOUBLE, TIME_DOUBLE = 6, 20
_EVENT_ADD = 1
_NORMAL = 1
_PAYLOAD_WORDS = {DOUBLE: 1, TIME_DOUBLE: 3}
_HEADER_WORDS = 2
UPDATE_SIZE = 8 * (_HEADER_WORDS + _PAYLOAD_WORDS[TIME_DOUBLE])
"""Length of a time-stamped update [bytes]."""


@dataclass(frozen=True, slots=True)
class Monitor:
    """One subscription of one client.

    Args:
        index: Which PV, as an index of the board.
        subscription: The client's number for it.
        channel: The server's number of the channel that it is on.
        data_type: DOUBLE or TIME_DOUBLE.
    """

    index: int
    subscription: int
    channel: int
    data_type: int


class Frames:
    """The updates of one client's monitors, in the order of the board.

    Args:
        monitors: Any number, in any order.
    """

    def __init__(self, monitors: Sequence[Monitor]) -> None:
        ordered = sorted(monitors, key=lambda monitor: monitor.index)
        lengths = [_HEADER_WORDS + _PAYLOAD_WORDS[m.data_type] for m in ordered]
        ends = np.cumsum(lengths, dtype=np.intp)
        self._spans = list(zip((ends - lengths).tolist(), ends.tolist(), strict=True))
        self._words = np.zeros(int(ends[-1]) if ordered else 0, dtype=">u8")
        self._values = self._words.view(">f8")
        self.index: NDArray[np.intp] = np.array([m.index for m in ordered], dtype=np.intp)
        self._value_at = ends - 1
        timed = np.array([m.data_type == TIME_DOUBLE for m in ordered], dtype=np.bool_)
        self._timed = self.index[timed]
        self._head_at = ends[timed] - 3
        self._tail_at = ends[timed] - 2
        for monitor, (start, end) in zip(ordered, self._spans, strict=True):
            size = (end - start - _HEADER_WORDS) * 8
            self._words[start] = _EVENT_ADD << 48 | size << 32 | monitor.data_type << 16 | 1
            self._words[start + 1] = _NORMAL << 32 | monitor.subscription

    def __len__(self) -> int:
        return len(self._spans)

    def fill(self, board: Board) -> None:
        """Take the present values, stamps and alarms from the board."""
        self._values[self._value_at] = board.value[self.index]
        self._words[self._head_at] = board.head[self._timed]
        self._words[self._tail_at] = board.tail[self._timed]

    def whole(self) -> bytes:
        """Give all updates as one block."""
        return self._words.tobytes()

    def part(self, rows: NDArray[np.intp]) -> bytes:
        """Give the updates of some monitors, rows of `index`, as one block."""
        if len(rows) == len(self):
            return self.whole()
        spans = (self._spans[row] for row in rows)
        return b"".join(self._words[start:end].tobytes() for start, end in spans)
