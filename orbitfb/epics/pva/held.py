"""What a PV over pvAccess holds: an NTScalarArray or NTScalar, as far as it is used here."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.epics.events import Head
from orbitfb.epics.libca import DBR_DOUBLE
from orbitfb.epics.records import EPICS_EPOCH, INVALID, NANOSECONDS
from orbitfb.epics.stated.contents import INTEGER, STRUCTURE, TEXT

_KINDS = {"f": DBR_DOUBLE, "i": INTEGER, "u": INTEGER, "b": 3, "U": TEXT, "S": TEXT}
"""Native types of Channel Access by the kind of an array of numpy."""
_LAST_SECOND = 2**32 - 1
"""Largest count of seconds since the EPICS epoch that a stamp holds: 32 bits."""
NO_LIMITS = (math.nan, math.nan)
"""Always this object: it equals itself, as no other NaN does."""


@dataclass(slots=True)
class Held:
    """The last that is known of a PV.

    Attributes:
        values: In its unit, shape (k,); NaN where it holds no numbers.
        kind: Native type in the numbers of db_access.h.
        head: Alarm and stamp; stamp 0: it has none.
        units: That it states; empty: none.
        limits: Drive limits that it states, low and high; NaN: none.
    """

    values: Vector = field(default_factory=lambda: np.zeros(0))
    kind: int = STRUCTURE
    head: Head = (0, INVALID, 0, 0)
    units: str = ""
    limits: tuple[float, float] = NO_LIMITS

    def take(self, told: Any) -> bool:
        """Take what has changed.

        Args:
            told: Value of p4p.

        Returns:
            Whether unit or limits did.
        """
        if told.changed("value"):
            self.values, self.kind = _numbers(_part(told, "value"))
        self.head = _head(told)
        if not told.changed("display", "control"):
            return False
        before = self.units, self.limits
        self.units = str(_part(told, "display.units") or "")
        low, high = (float(_part(told, f"control.limit{end}") or 0.0) for end in ("Low", "High"))
        self.limits = (low, high) if low < high else NO_LIMITS
        return before != (self.units, self.limits)


def _part(told: Any, name: str) -> Any:
    """Give a field, or None where the structure has none of that name."""
    return told[name] if told.has(name) else None


def _numbers(value: Any) -> tuple[Vector, int]:
    given = np.atleast_1d(np.asarray(value))
    kind = _KINDS.get(given.dtype.kind, STRUCTURE)
    if kind == STRUCTURE:
        return np.zeros(0), kind
    if kind == TEXT:
        return np.full(given.size, np.nan), kind
    return given.astype(np.float64), kind


def _head(told: Any) -> Head:
    """Give alarm and stamp; one without an alarm has none, one without a stamp the stamp 0."""
    severity, status = (int(_part(told, f"alarm.{part}") or 0) for part in ("severity", "status"))
    since_1970 = int(_part(told, "timeStamp.secondsPastEpoch") or 0)
    nanoseconds = int(_part(told, "timeStamp.nanoseconds") or 0)
    seconds = since_1970 - EPICS_EPOCH
    if not 0 < seconds <= _LAST_SECOND or not 0 <= nanoseconds < NANOSECONDS:
        seconds = nanoseconds = 0
    return status % 2**15, severity, seconds, nanoseconds
