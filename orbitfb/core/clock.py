"""The system's clocks and one that tests move by hand."""

import time


class SystemClock:
    """Wall and monotonic clock of this computer."""

    def wall(self) -> float:
        """Now [s since the epoch]."""
        return time.time()

    def monotonic(self) -> float:
        """Now on a clock that never steps [s]."""
        return time.monotonic()


class ManualClock:
    """A clock that stands still until it is advanced."""

    def __init__(self, start: float = 1.0e9) -> None:
        self._now = start

    def advance(self, seconds: float) -> None:
        """Move both clocks forward [s]."""
        self._now += seconds

    def wall(self) -> float:
        """Now [s since the epoch]."""
        return self._now

    def monotonic(self) -> float:
        """Now on a clock that never steps [s]."""
        return self._now
