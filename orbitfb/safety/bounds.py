"""Least and largest setpoint of each corrector: ours, or the machine's own where it is narrower."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Mask, Vector

ROUNDING = 2e-6
"""By how much a setpoint at its drive limit may seem to be beyond it [A]: records and supplies keep
numbers up to 20 A in single precision, whose last digit is 2e-6 A there."""


@dataclass(frozen=True, slots=True)
class Bounds:
    """Where the setpoint of each corrector may be.

    Args:
        low: Least setpoints, shape (m,) [A].
        high: Largest setpoints, shape (m,) [A].
        drive: Correctors whose drive limits are narrower than ours, shape (m,).
    """

    low: Vector
    high: Vector
    drive: Mask

    @classmethod
    def of(cls, limit: float, correctors: int, drive: NDArray[np.float64] | None = None) -> Self:
        """Take the narrower of a limit for all and the drive limits of the machine.

        Args:
            limit: Largest |setpoint| of all [A].
            correctors: m.
            drive: Drive limits, shape (m, 2), low and high [A]; NaN: none; None: none at all.
        """
        low, high = np.full(correctors, -limit), np.full(correctors, limit)
        if drive is None:
            return cls(low, high, np.zeros(correctors, dtype=np.bool_))
        narrow = (drive[:, 0] > low) | (drive[:, 1] < high)
        return cls(np.fmax(low, drive[:, 0]), np.fmin(high, drive[:, 1]), narrow)

    @property
    def largest(self) -> Vector:
        """Largest |setpoint| of each, shape (m,) [A]."""
        return np.maximum(np.abs(self.low), np.abs(self.high))

    def stranded(self, setpoints: Vector) -> Mask:
        """Find setpoints beyond drive limits, shape (m,): a put would make them jump to the limit.

        Args:
            setpoints: In force, shape (m,) [A].
        """
        beyond = (setpoints > self.high + ROUNDING) | (setpoints < self.low - ROUNDING)
        return self.drive & beyond

    def room(self, change: Vector, setpoints: Vector) -> Vector:
        """Tell how far each corrector may go in the direction of a change, shape (m,) [A].

        Args:
            change: Shape (m,) [A].
            setpoints: In force, shape (m,) [A].
        """
        room = np.where(change < 0, setpoints - self.low, self.high - setpoints)
        return np.where(self.stranded(setpoints), 0.0, np.maximum(room, 0.0))

    def name(self, which: Mask, names: Sequence[str], at_most: int = 5) -> str:
        """List some correctors, each with its limits where they are not those of all.

        Args:
            which: Shape (m,).
            names: m names; when empty, the indices stand in for them.
            at_most: How many are spelt out.
        """
        where = np.flatnonzero(which).tolist()
        shown: list[str] = []
        for index in where[:at_most]:
            name = names[index] if names else f"#{index}"
            limits = f" ({self.low[index]:g} to {self.high[index]:g} A)"
            shown.append(name + limits if self.drive[index] else name)
        more = len(where) - len(shown)
        return ", ".join(shown) + (f" and {more} more" if more else "")


def narrower(limit: float, drive: NDArray[np.float64], names: Sequence[str]) -> str:
    """Say which correctors have narrower drive limits than ours; empty if none has.

    Args:
        limit: Largest |setpoint| of all, `limits.setpoint` [A].
        drive: Drive limits, shape (m, 2), low and high [A]; NaN: none.
        names: The m correctors.
    """
    bounds = Bounds.of(limit, len(names), drive)
    if not (count := int(np.count_nonzero(bounds.drive))):
        return ""
    return (
        f"{count} correctors have drive limits narrower than limits.setpoint ({limit:g} A), which "
        f"hold for them: {bounds.name(bounds.drive, names)}"
    )
