"""The last value, stamp and alarm of every published PV, as columns.

A tick fills columns instead of writing hundreds of objects; clients' frames are cut from them.
Indices run over the readings first, then over the setpoints.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Mask, Vector
from orbitfb.sim.access.stamp import Stamp
from orbitfb.sim.layout import Layout, PvSpec, Range

Words = NDArray[np.uint64]

LOLO, LOW, HIGH, HIHI, WRITE, UNDEFINED = 5, 6, 4, 3, 2, 17
MINOR, MAJOR, INVALID = 1, 2, 3
_SHIFT = np.uint64(32)


def _alarm(status: int, severity: int) -> np.uint64:
    return np.uint64(status << 16 | severity)


class Entry(NamedTuple):
    """One PV as a reader sees it."""

    value: float
    stamp: Stamp
    status: int
    severity: int


class AlarmLimits:
    """Judges values against the LOLO, LOW, HIGH and HIHI of their PVs.

    A value on the limit is in alarm, as in EPICS; one that is not finite is INVALID.
    """

    def __init__(self, specs: tuple[PvSpec, ...]) -> None:
        def ends(ranges: list[Range]) -> tuple[Vector, Vector]:
            ends = np.array([r if r[0] != r[1] else (-np.inf, np.inf) for r in ranges])
            return ends.reshape(-1, 2)[:, 0], ends.reshape(-1, 2)[:, 1]

        self._low, self._high = ends([spec.warning for spec in specs])
        self._lolo, self._hihi = ends([spec.alarm for spec in specs])
        self._quiet_low = np.maximum(self._low, self._lolo)
        self._quiet_high = np.minimum(self._high, self._hihi)

    def judge(self, values: Vector) -> Words:
        """Give status and severity of every value as status·2¹⁶ + severity."""
        words = np.zeros(len(values), dtype=np.uint64)
        if np.all((values > self._quiet_low) & (values < self._quiet_high)):
            return words
        words[values <= self._low] = _alarm(LOW, MINOR)
        words[values >= self._high] = _alarm(HIGH, MINOR)
        words[values <= self._lolo] = _alarm(LOLO, MAJOR)
        words[values >= self._hihi] = _alarm(HIHI, MAJOR)
        words[~np.isfinite(values)] = _alarm(UNDEFINED, INVALID)
        return words


class Board:
    """Columns of all published PVs.

    Args:
        layout: The PVs.
        stamp: Stamp of what is there before the first tick.

    Attributes:
        value: In the PVs' units, shape (readings + setpoints,).
        head: First word of a time-stamped value: alarm, then the stamp's seconds.
        tail: Second word: the stamp's nanoseconds in the upper half.
        written: Setpoints that were written since the last tick, shape (m,).
    """

    def __init__(self, layout: Layout, stamp: Stamp) -> None:
        self.names = tuple(s.name for s in (*layout.readings, *layout.setpoints))
        self.readings = len(layout.readings)
        count = len(self.names)
        self.value: Vector = np.zeros(count)
        self.value[self.readings :] = [spec.initial for spec in layout.setpoints]
        self.head: Words = np.full(count, stamp.seconds, dtype=np.uint64)
        self.tail: Words = np.full(count, stamp.nanoseconds, dtype=np.uint64) << _SHIFT
        self.written: Mask = np.zeros(len(layout.setpoints), dtype=np.bool_)
        self._reading_limits = AlarmLimits(layout.readings)
        self._setpoint_limits = AlarmLimits(layout.setpoints)
        drives = np.array([spec.drive for spec in layout.setpoints]).reshape(-1, 2)
        self._drive_low, self._drive_high = drives[:, 0], drives[:, 1]

    @property
    def setpoints(self) -> Vector:
        """The setpoints in force, in the order and the units of the layout: a view."""
        return self.value[self.readings :]

    def show(self, values: Vector, stamp: Stamp) -> None:
        """Take the readings of a tick, all under one stamp."""
        part = slice(0, self.readings)
        self.value[part] = values
        self.head[part] = self._reading_limits.judge(values) << _SHIFT | np.uint64(stamp.seconds)
        self.tail[part] = np.uint64(stamp.nanoseconds << 32)

    def allowed(self, which: NDArray[np.intp], values: Vector) -> Mask:
        """Say which of these setpoints may be written; what is not finite may not."""
        return (values >= self._drive_low[which]) & (values <= self._drive_high[which])

    def write(self, which: NDArray[np.intp], values: Vector, stamp: Stamp) -> None:
        """Take setpoints that are allowed; of several to one channel, the last stays."""
        self.setpoints[which] = values
        self.written[which] = True
        at = which + self.readings
        alarms = self._setpoint_limits.judge(self.setpoints)[which]
        self.head[at] = alarms << _SHIFT | np.uint64(stamp.seconds)
        self.tail[at] = np.uint64(stamp.nanoseconds << 32)

    def set(self, index: int, entry: Entry) -> None:
        """Overwrite one PV as it stands."""
        self.value[index] = entry.value
        alarm = entry.status << 16 | entry.severity
        self.head[index] = alarm << 32 | entry.stamp.seconds
        self.tail[index] = entry.stamp.nanoseconds << 32

    def get(self, index: int) -> Entry:
        """Read one PV."""
        head, tail = int(self.head[index]), int(self.tail[index])
        stamp = Stamp(head & 0xFFFFFFFF, tail >> 32)
        return Entry(float(self.value[index]), stamp, head >> 48, head >> 32 & 0xFFFF)
