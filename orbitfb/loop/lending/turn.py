"""Whose turn it is to move the setpoints of an open loop."""

import threading

from orbitfb.core.errors import ControlError


class Turn:
    """Belongs to one at a time; asked for and given back in any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._holder = ""
        self._ended = ""

    def take(self, name: str) -> None:
        """Take it.

        Args:
            name: Who takes it, for messages.

        Raises:
            ControlError: Somebody else has it, or the loop has ended.
        """
        with self._lock:
            if self._ended:
                raise ControlError(f"{name} refused: {self._ended}")
            if self._holder:
                raise ControlError(f"{name} refused: {self._holder} is under way")
            self._holder = name

    def leave(self) -> None:
        """Give it back."""
        with self._lock:
            self._holder = ""

    def end(self, reason: str) -> None:
        """Refuse whoever asks from now on: the loop has ended."""
        with self._lock:
            self._ended = reason
