"""Which ticks were answered, so that their rows may teach: a ledger of the signs of an answer.

A sign of an answer says that the ring answered while it was gathered, so that the ticks before
that are believed, if what fails stays away. The later ones wait. Those that wait when something is
found not to answer, or when the loop opens without another sign, never teach.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Mask
from orbitfb.core.values import replace
from orbitfb.safety.answers.owing import Answering

KEPT = 64
"""Stretches of refused ticks that are remembered: more lie within no history that is kept."""


@dataclass(frozen=True)
class Believed:
    """What is known of the ticks so far.

    Args:
        until: Ticks before this one are judged: believed, unless they are refused.
        gathering: Tick at which the sign of an answer that comes next began to be gathered.
        quiet: Ticks before this one were judged while nobody was in doubt.
        refused: Stretches of ticks that were not answered, from and up to, oldest first.
        count: Ticks that were refused so far.
        since: When the ring answered last, monotonic [s].
        found: How often something was found not to answer.
        asking: Whether the loop asks.
        asked: Ticks at which it did so far.
        closed: Whether it is CLOSED, and heeds answers.
    """

    until: int = 0
    gathering: int = 0
    quiet: int = 0
    refused: tuple[tuple[int, int], ...] = ()
    count: int = 0
    since: float = float("nan")
    found: int = 0
    asking: bool = False
    asked: int = 0
    closed: bool = False

    def teaches(self, ticks: NDArray[np.int64]) -> Mask:
        """Tell which ticks were answered; False also for those that wait, shape (T,).

        Args:
            ticks: Shape (T,).
        """
        good = ticks < self.until
        for begin, end in self.refused:
            good &= (ticks < begin) | (ticks >= end)
        return good

    def follow(self, tick: int, answering: Answering) -> "Believed":
        """Take in what the loop knows after a tick.

        Args:
            tick: Number of it; its orbit was looked at.
            answering: What the loop remembers of answers.
        """
        since, found, closed = answering.since, answering.found, answering.owed is not None
        asking = answering.session is not None
        now = replace(
            self,
            since=since,
            found=found,
            asking=asking,
            asked=self.asked + asking,
            closed=closed,
        )
        if found != self.found:
            return now._refuse(min(self.quiet, self.until), tick)
        if not closed:
            return now._refuse(self.until, tick) if self.closed else now._judged(tick)
        if not self.closed:
            return now._judged(tick)
        if since != self.since:
            now = replace(now, until=self.gathering, gathering=tick)
        elif asking and not self.asking:
            now = replace(now, gathering=tick)
        return now if asking or not self.asking else replace(now, quiet=now.until)

    def _judged(self, tick: int) -> "Believed":
        return replace(self, until=tick, gathering=tick, quiet=tick)

    def _refuse(self, begin: int, end: int) -> "Believed":
        if begin >= end:
            return self._judged(end)
        refused = (*self.refused, (begin, end))[-KEPT:]
        return replace(self, refused=refused, count=self.count + end - begin)._judged(end)
