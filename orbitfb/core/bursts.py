"""What somebody does again and again: the first are told one by one, the rest as a count."""

import threading
from dataclasses import dataclass

from orbitfb.core.ports import Clock

ONE_BY_ONE = 20
"""Commands or refusals of one source that are told one by one: as many as a screen that sets a
panel's every value, each of which somebody may ask about."""

REST = "others"
"""Stands for all sources beyond the bound."""


@dataclass(slots=True)
class _Burst:
    since: float
    told: int = 0
    counted: int = 0
    detail: str = ""


class Bursts:
    """Say what is to be told now, so that nobody fills a log; called from any thread.

    Args:
        clock: Tells the time.
        quiet_time: Time for which the rest of a burst is counted before it is told [s].
        free: How many of a burst are told one by one.
        most: Sources that are told apart; more are counted together, so that inventing names does
            not help.
    """

    def __init__(
        self, clock: Clock, quiet_time: float = 10.0, free: int = ONE_BY_ONE, most: int = 32
    ) -> None:
        self._clock, self._quiet_time, self._free, self._most = clock, quiet_time, free, most
        self._bursts: dict[str, _Burst] = {}
        self._guard = threading.Lock()

    def add(self, source: str, detail: str = "", times: int = 1) -> int:
        """Count one more.

        Args:
            source: Who does it.
            detail: What to tell of the last one if it is only counted.
            times: How often it was done.

        Returns:
            How many to tell now, this one included; 0: it is counted.
        """
        now = self._clock.monotonic()
        with self._guard:
            if source not in self._bursts and len(self._bursts) >= self._most:
                source = REST
            burst = self._bursts.setdefault(source, _Burst(now))
            if burst.told < self._free:
                burst.told += 1
                return times
            burst.counted += times
            burst.detail = detail
            return 0

    def due(self) -> list[tuple[str, str, int]]:
        """Give what was counted and is to be told now: source, last detail, count.

        Call it every now and then: it also forgets those who have been quiet.
        """
        now = self._clock.monotonic()
        told: list[tuple[str, str, int]] = []
        with self._guard:
            for source, burst in list(self._bursts.items()):
                if now - burst.since < self._quiet_time:
                    continue
                if burst.counted:
                    told.append((source, burst.detail, burst.counted))
                    self._bursts[source] = _Burst(now, told=self._free)
                else:
                    del self._bursts[source]
        return told
