"""The largest orbit RMS of late: what is asked now and then misses nothing between two askings."""

import math
import threading
from collections import deque
from collections.abc import Sequence

import numpy as np

from orbitfb.core.signals import TickRecord, parts

SLOT, SLOTS = 0.25, 6
"""Length of a slot of time [s], and how many are kept: more than a second, as who asks once a
second is late at times."""


class Peaks:
    """Keeps the largest RMS of each plane in the last slots of time; a subscriber of the loop.

    Args:
        planes: Under feedback; vectors are x first, then y.
        counts: BPMs of each plane; empty: as many in each.
    """

    def __init__(self, planes: str, counts: Sequence[int] = ()) -> None:
        self._planes, self._counts = planes, counts
        self._lock = threading.Lock()
        self._slots: deque[tuple[int, list[float]]] = deque(maxlen=SLOTS)

    def __call__(self, record: TickRecord) -> None:
        """Take a record; called in the loop's thread."""
        if record.reading is None:
            return
        orbit = record.reading.orbit
        error, count = orbit.position - record.reference, len(self._planes)
        slot = int(record.reading.received // SLOT)
        with self._lock:
            if not self._slots or self._slots[-1][0] != slot:
                self._slots.append((slot, [math.nan] * count))
            largest = self._slots[-1][1]
            for at, part in enumerate(parts(self._planes, error.size, self._counts).values()):
                valid = error[part][orbit.valid[part]]
                rms = math.sqrt(float(valid @ valid) / valid.size) if valid.size else math.nan
                largest[at] = float(np.fmax(largest[at], rms))

    def since(self, now: float) -> dict[str, float]:
        """Give the largest of the last slots by plane [m]; NaN where there was no orbit.

        Args:
            now: Monotonic time of the loop's clock [s].
        """
        oldest = int(now // SLOT) - SLOTS
        with self._lock:
            rows = [largest for slot, largest in self._slots if slot > oldest]
            return {
                plane: float(np.fmax.reduce([row[at] for row in rows], initial=math.nan))
                for at, plane in enumerate(self._planes)
            }
