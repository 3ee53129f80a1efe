"""Readings that a cause has no use for: they stay as likely as they are without it.

What stands for those that it lacks says nothing. A cause would gain by leaving out what it does
not explain otherwise.
"""

from collections.abc import Callable

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.effects.device_kinds import SensorKind
from orbitfb.physics.optics import Matrix
from orbitfb.records.record import Record

_ENOUGH = 300
"""Rows from which those before them are predicted."""


def owed_for_unread(
    record: Record,
    floor: NoiseFloor,
    cause: Cause,
    before: Matrix,
    after: Callable[[], Matrix],
    left: Callable[[], Matrix],
) -> Vector:
    """What a cause owes for readings that it has no use for, shape (N,) [nats].

    Args:
        record: What happened.
        floor: The noise.
        cause: Put into the model.
        before: White innovations without it, shape (N, n).
        after: Gives white innovations with it, shape (N, n).
        left: Gives what is left without it before that is whitened, shape (N, n) [m].
    """
    kind, owed = cause.kind, np.zeros(len(record))
    rows = kind.unread(cause.values) if isinstance(kind, SensorKind) else 0
    if not rows:
        return owed
    columns = list(cause.places)
    for piece in record.stretches:
        begin = max(piece.start, cause.onset)
        count = min(rows, piece.stop - begin)
        if count > 0:
            lost = before[begin : begin + count]
            if begin == piece.start:
                lost = _backwards(floor, left()[begin : piece.stop], count)
            filled = slice(piece.stop - count, piece.stop)
            squares = [floor.by_bpm(own)[:, columns] ** 2 for own in (lost, after()[filled])]
            owed[filled] = 0.5 * np.sum(squares[0] - squares[1], axis=1)
    return owed


def _backwards(floor: NoiseFloor, left: Matrix, count: int) -> Matrix:
    """Innovations of the first rows of a stretch, predicted from those after them: (count, n).

    A random walk goes backwards as it goes forwards.
    """
    turned = left[_ENOUGH + count - 1 :: -1]
    starts = np.arange(len(turned)) == 0
    return floor.whiten(turned, starts)[-count:][::-1]
