"""Every change of the setpoints is heard, and told from those that this program has sent.

Channel Access does not say who put a value. What was not sent from here was put by somebody else: a
second controller's setpoints lie too near to ours to be noticed by their size.
"""

from collections import deque

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.epics.records import blank_records
from orbitfb.safety.bounds import ROUNDING

SENDS = 64
"""Sends whose answers may be on their way: `answer_timeout` (1 s) at the 50 Hz at which Channel
Access still carries a ring."""
EVENTS = 16
"""Changes of each setpoint that wait to be looked at. A tick has one of ours and one of each other
controller; what is beyond is dropped, the oldest first, and hides nobody who goes on."""


class PutWatch:
    """Hears the setpoints on libca's threads; one thread takes what was heard.

    A record that rounds what is put never shows the value that was sent. Such a one tells nothing
    as long as something is put to it from here.

    Args:
        size: Number of setpoints.

    Attributes:
        records: Where the events of the setpoints are written.
    """

    def __init__(self, size: int) -> None:
        self.records = blank_records(size)
        self._values = self.records["value"]
        self._sent: deque[Vector] = deque(maxlen=SENDS)
        self._heard: deque[tuple[int, float]] = deque(maxlen=EVENTS * size)
        self._first = [True] * size
        self._echoes: Mask = np.zeros(size, dtype=np.bool_)

    def came(self, index: int) -> None:
        """Note that a channel has come: its next event tells where it is, not that it was put."""
        self._first[index] = True

    def heard(self, index: int) -> None:
        """Take an event that was written to the records."""
        if self._first[index]:
            self._first[index] = False
            return
        self._heard.append((index, self._values.item(index)))

    def sends(self, values: Vector, which: Mask) -> None:
        """Note what is about to be sent.

        Args:
            values: Shape (m,), in the unit of the PVs.
            which: Setpoints that are put, shape (m,).
        """
        self._sent.append(np.where(which, values, np.nan))

    def was_sent(self, values: Vector) -> Mask:
        """Tell which values were sent from here a short while ago, shape (m,)."""
        sent = np.array([np.full(len(self.records), np.nan), *self._sent])
        return np.any(np.abs(sent - values) <= ROUNDING, axis=0, keepdims=True)[0]

    def take(self) -> Mask | None:
        """Give the setpoints that others have put since the last call, shape (m,); None: none."""
        count = len(self._heard)
        if not count:
            return None
        indices, heard = zip(*[self._heard.popleft() for _ in range(count)], strict=True)
        which, values = np.array(indices), np.array(heard)
        if self._sent and bool((np.abs(self._sent[-1][which] - values) <= ROUNDING).all()):
            self._echoes[which] = True  # all of them are what was sent last: nobody else put one
            return None
        sent = np.array([np.full(len(self.records), np.nan), *self._sent])
        ours = (np.abs(sent[:, which] - values) <= ROUNDING).any(axis=0)
        self._echoes[which[ours]] = True
        tells = self._echoes | ~np.isfinite(sent).any(axis=0)
        others = np.zeros(len(self.records), dtype=np.bool_)
        others[which[~ours & np.isfinite(values)]] = True
        others &= tells
        return others if others.any() else None
