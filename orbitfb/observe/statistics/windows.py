"""Windows in time and the latency histogram: what makes running figures cheap."""

import math
from bisect import bisect_left
from collections import deque

import numpy as np

LATENCY_BOUNDS = (
    1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1, 0.2, 0.5, 1.0,
)  # fmt: skip
"""Upper bounds of the buckets of the latency histogram [s]."""

MOST = 100_000
"""Entries that a window keeps at most, whatever the stamps say."""


class Window:
    """Values of the last `span` seconds, by the stamps that come with them.

    Args:
        span: Length of the window [s].
    """

    def __init__(self, span: float) -> None:
        self._span = span
        self._entries: deque[tuple[float, float]] = deque(maxlen=MOST)

    def add(self, time: float, value: float) -> None:
        """Take a value and forget those older than the window.

        Args:
            time: Stamp [s since the epoch]. When it lies before the last one (the clock of the
                machine was set back) the values of the time to come are forgotten too.
            value: Value; NaN is not kept but moves the window on.
        """
        entries = self._entries
        while entries and entries[-1][0] > time:
            entries.pop()
        oldest = time - self._span
        while entries and entries[0][0] <= oldest:
            entries.popleft()
        if not math.isnan(value):
            entries.append((time, value))

    def copy(self) -> list[tuple[float, float]]:
        """Copy the (stamp, value) pairs, oldest first."""
        return list(self._entries)


def root_mean(entries: list[tuple[float, float]]) -> float:
    """Return the root of the mean of values that are mean squares; NaN if there are none."""
    if not entries:
        return math.nan
    return math.sqrt(math.fsum(value for _, value in entries) / len(entries))


def percentiles(entries: list[tuple[float, float]], *ranks: float) -> list[float]:
    """Return percentiles of the values; NaN if there are none.

    Args:
        entries: (stamp, value) pairs.
        ranks: Percentiles to take [%].
    """
    if not entries:
        return [math.nan] * len(ranks)
    values = np.array([value for _, value in entries])
    return [float(figure) for figure in np.percentile(values, ranks)]


def mean_and_deviation(entries: list[tuple[float, float]]) -> tuple[float, float]:
    """Return mean and standard deviation of the values; NaN where unknown."""
    if not entries:
        return math.nan, math.nan
    values = np.array([value for _, value in entries])
    deviation = float(values.std(ddof=1)) if len(values) > 1 else math.nan
    return float(values.mean()), deviation


class Histogram:
    """Counts of durations in the buckets of `LATENCY_BOUNDS`, since the start."""

    def __init__(self) -> None:
        self._counts = [0] * (len(LATENCY_BOUNDS) + 1)
        self.total = 0.0
        self.largest = math.nan

    def add(self, duration: float) -> None:
        """Count a duration [s]; NaN is not counted."""
        if math.isnan(duration):
            return
        self._counts[bisect_left(LATENCY_BOUNDS, duration)] += 1
        self.total += duration
        if not duration <= self.largest:  # also true while `largest` is NaN
            self.largest = duration

    def cumulative(self) -> tuple[int, ...]:
        """Return how many lie at or below each bound, then how many there are."""
        return tuple(int(count) for count in np.cumsum(self._counts))
