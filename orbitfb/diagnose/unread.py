"""Readings that a cause has no use for: they stay as likely as they are without it.

What stands for those that it lacks says nothing. A cause would gain by leaving out what it does
not explain otherwise.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.effects.device_kinds import SensorKind
from orbitfb.effects.record import Record
from orbitfb.physics.optics import Matrix

_ENOUGH = 300
"""Rows from which those before them are predicted."""


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """A record as judged without a cause.

    Args:
        record: What happened.
        floor: The noise.
        left: Gives what is left before it is whitened, shape (N, n) [m].
    """

    record: Record
    floor: NoiseFloor
    left: Callable[[], Matrix]

    def owed(self, cause: Cause, before: Matrix, after: Matrix) -> Vector:
        """What a cause owes for readings that it has no use for, shape (N,) [nats].

        Args:
            cause: Put into the model.
            before: White innovations without it, shape (N, n).
            after: White innovations with it, shape (N, n).
        """
        kind, owed = cause.kind, np.zeros(len(self.record))
        rows = kind.unread(cause.values) if isinstance(kind, SensorKind) else 0
        if not rows:
            return owed
        columns = list(cause.places)
        for piece in self.record.stretches:
            begin = max(piece.start, cause.onset)
            count = min(rows, piece.stop - begin)
            if count > 0:
                lost = before[begin : begin + count]
                if begin == piece.start:
                    lost = self._backwards(slice(begin, piece.stop), count)
                filled = slice(piece.stop - count, piece.stop)
                squares = [self.floor.by_bpm(own)[:, columns] ** 2 for own in (lost, after[filled])]
                owed[filled] = 0.5 * np.sum(squares[0] - squares[1], axis=1)
        return owed

    def _backwards(self, piece: slice, count: int) -> Matrix:
        """Innovations of the first rows of a stretch, predicted from those after them: (count, n).

        A random walk goes backwards as it goes forwards.
        """
        turned = self.left()[piece][_ENOUGH + count - 1 :: -1]
        starts = np.arange(len(turned)) == 0
        return self.floor.whiten(turned, starts)[-count:][::-1]
