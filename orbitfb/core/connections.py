"""Room for a bounded number of connections: those who only hold one open give way."""

import threading
from collections import Counter
from typing import Generic, TypeVar

C = TypeVar("C")


class Connections(Generic[C]):
    """Count connections in and out; say which one has to go when there are too many.

    The oldest idle one gives way, of the host that has most of them: whoever opens many loses
    their own first. Those that are busy stay. Called from any thread.

    Args:
        most: Connections at a time, idle and busy ones together.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._idle: dict[C, str] = {}  # in the order in which they came
        self._busy: set[C] = set()
        self._guard = threading.Lock()

    def __len__(self) -> int:
        """Count them."""
        with self._guard:
            return len(self._idle) + len(self._busy)

    def add(self, connection: C, host: str = "") -> C | None:
        """Take one in, idle as yet.

        Args:
            connection: The new one.
            host: Where it comes from.

        Returns:
            The one that has to be closed, which is forgotten here: an older one, or the new one
            itself if all others are busy; None while there is room.
        """
        with self._guard:
            self._idle[connection] = host
            if len(self._idle) + len(self._busy) <= self._most:
                return None
            [(greediest, _)] = Counter(self._idle.values()).most_common(1)
            oldest = next(each for each, its in self._idle.items() if its == greediest)
            del self._idle[oldest]
            return oldest

    def keep(self, connection: C) -> None:
        """Count one as busy from now on; one that had to go stays forgotten."""
        with self._guard:
            if self._idle.pop(connection, None) is not None:
                self._busy.add(connection)

    def remove(self, connection: C) -> None:
        """Count one out; nothing happens to one that is not counted."""
        with self._guard:
            self._idle.pop(connection, None)
            self._busy.discard(connection)

    def all(self) -> tuple[C, ...]:
        """Give them all."""
        with self._guard:
            return (*self._idle, *self._busy)
