"""Notices that somebody set a clock, by the clocks that nobody can set."""

import math
from collections.abc import Callable

from orbitfb.core.ports import Clock
from orbitfb.core.signals import TickRecord

OURS, THEIRS = 0.5, 2.0
"""Steps that count, of this computer's clock and of that of the machine [s].

An orbit may be a second old, so that the stamps of two differ by so much more or less.
"""


class ClockWatch:
    """Says that a clock was set: a subscriber of the loop.

    Args:
        clock: The loop's clock.
        tell: Gets a sentence, in the loop's thread.

    Attributes:
        steps: How often a clock was set.
    """

    def __init__(self, clock: Clock, tell: Callable[[str], None]) -> None:
        self._clock, self._tell = clock, tell
        self._ours = self._theirs = math.nan
        self.steps = 0

    def __call__(self, record: TickRecord) -> None:
        """Take a record."""
        now = self._clock.wall() - self._clock.monotonic()
        ours, self._ours = now - self._ours, now
        told: list[str] = []
        if abs(ours) > OURS:
            told.append(f"the clock of this computer by {ours:+.3g} s")
        if record.reading is not None:
            now = record.reading.orbit.time - record.reading.received
            theirs, self._theirs = now - self._theirs, now
            if abs(theirs) > THEIRS:
                told.append(f"the clock of the machine's stamps by {theirs:+.3g} s")
        if told:
            self.steps += 1
            self._tell(f"somebody set {' and '.join(told)}")
