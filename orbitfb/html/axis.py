"""The axis of a picture: its range, its ticks, and numbers of which some may be missing."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector

_TICKS = 5
"""Ticks of an axis, about."""

Numbers = Sequence[float | None] | Vector


def values(numbers: Numbers) -> Vector:
    """Make an array of numbers; NaN where one is not resolved."""
    return np.array([np.nan if number is None else number for number in numbers], dtype=float)


def known(numbers: Numbers) -> bool:
    """Tell whether there is any number to draw."""
    return bool(np.isfinite(values(numbers)).any()) if len(numbers) else False


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis of a panel.

    Args:
        label: With the unit.
        low: Value at its beginning.
        high: Value at its end.
        log: Whether it is logarithmic.
        ticks: Values with their words; None: round numbers.
    """

    label: str
    low: float
    high: float
    log: bool = False
    ticks: Sequence[tuple[float, str]] | None = None

    @classmethod
    def over(cls, label: str, *numbers: Numbers, zero: bool = False, log: bool = False) -> "Axis":
        """An axis that holds numbers, and zero where it is asked for."""
        every = np.concatenate([values(one) for one in numbers] or [np.zeros(1)])
        every = every[np.isfinite(every) & ((every > 0.0) | (not log))]
        low, high = (float(every.min()), float(every.max())) if len(every) else (0.0, 1.0)
        if log:
            return cls(label, low / 1.1, high * 1.1, log=True)
        if zero:
            low, high = min(low, 0.0), max(high, 0.0)
        room = 0.06 * ((high - low) or abs(high) or 1.0)
        return cls(label, low - (0.0 if zero and low == 0.0 else room),
                   high + (0.0 if zero and high == 0.0 else room))  # fmt: skip

    def share(self, value: float) -> float:
        """Where a value lies between the ends [1]."""
        if self.log:
            top, bottom = np.log(self.high), np.log(self.low)
            return float((np.log(max(value, 1e-300)) - bottom) / (top - bottom))
        return (value - self.low) / ((self.high - self.low) or 1.0)

    def marks(self) -> Sequence[tuple[float, str]]:
        """Ticks with their words."""
        if self.ticks is not None:
            return self.ticks
        if self.log:
            first, last = int(np.ceil(np.log10(self.low))), int(np.floor(np.log10(self.high)))
            step = max(1, (last - first) // _TICKS + 1)
            return [(10.0**n, f"{10.0**n:g}") for n in range(first, last + 1, step)]
        rough = (self.high - self.low) / _TICKS
        unit = 10.0 ** np.floor(np.log10(rough)) if rough > 0.0 else 1.0
        step = float(unit * next(x for x in (1, 2, 5, 10) if x * unit >= rough))
        first = np.ceil(self.low / step - 1e-9)
        places = step * np.arange(first, np.floor(self.high / step + 1e-9) + 1)
        return [(float(place), f"{0.0 if abs(place) < step / 2 else place:g}") for place in places]
