"""What a client of the panel sends, looked at before anything of it is kept.

A message of Channel Access says in its head how long it is. caproto keeps all of a message until
it is complete, so one that claims 4 GB would be kept for as long as it lasts. Nobody needs more
than the longest PV, and nobody writes by hand as fast as a program can.
"""

from orbitfb.core.ports import Clock

WRITES = frozenset({4, 19})
"""Commands that write: without and with an answer."""
STEADY = 20.0
"""Writes per second that a client may keep up: a slider that is dragged gives as many."""
AT_ONCE = 200
"""Writes that a client may send at once: a screen that sets all 30 PVs, several times over."""

_HEAD, _LONG_HEAD = 16, 24
_SHORT = 0xFFFF
"""Size in a short head that announces a long one, with a count of 0."""


class Intake:
    """Follows the messages of one client.

    Args:
        longest: Longest message [bytes].
        clock: Tells the time.
    """

    def __init__(self, longest: int, clock: Clock) -> None:
        self._longest, self._clock = longest, clock
        self._head = b""
        self._left = 0
        self._budget = float(AT_ONCE)
        self._filled = clock.monotonic()

    def take(self, data: bytes) -> str:
        """Look at what came.

        Args:
            data: The next bytes.

        Returns:
            Why the client has to go; empty: it may stay.
        """
        place = 0
        while place < len(data):
            if self._left:
                step = min(self._left, len(data) - place)
                self._left -= step
                place += step
                continue
            wanted = self._wanted() - len(self._head)
            self._head += data[place : place + wanted]
            place += wanted
            if len(self._head) >= self._wanted():
                command, self._left = self._read()
                if self._left > self._longest:
                    return (
                        f"a message of {self._left} bytes was announced, {self._longest} are read"
                    )
                if command in WRITES and not self._may_write():
                    return f"more than {AT_ONCE} writes at once, and then {STEADY:g} per second"
        return ""

    def _wanted(self) -> int:
        """Give the length of the head that has begun [bytes]."""
        if len(self._head) < _HEAD:
            return _HEAD
        size, count = int.from_bytes(self._head[2:4]), int.from_bytes(self._head[6:8])
        return _LONG_HEAD if size == _SHORT and not count else _HEAD

    def _read(self) -> tuple[int, int]:
        """Read a whole head: the command, and the length of what follows [bytes]."""
        head, self._head = self._head, b""
        size = head[16:20] if len(head) == _LONG_HEAD else head[2:4]
        return int.from_bytes(head[:2]), int.from_bytes(size)

    def _may_write(self) -> bool:
        now = self._clock.monotonic()
        self._budget = min(AT_ONCE, self._budget + STEADY * (now - self._filled)) - 1.0
        self._filled = now
        return self._budget >= 0.0
