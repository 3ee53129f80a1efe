"""What every BPM and every corrector did of late: the worst of them, and how much was moved."""

import math
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Channels, Mask, TickRecord, Vector

SHOWN = 5
"""How many BPMs and correctors are told by name."""


@dataclass(frozen=True, slots=True)
class Ranked:
    """A device that stands out.

    Args:
        name: As in the places table.
        plane: `x` or `y`.
        value: How much [m] or, of a corrector, as part of its limit [1].
    """

    name: str
    plane: str
    value: float


class Averages:
    """Exponential averages over the ticks: a few vector operations for each.

    Args:
        channels: Names behind the vectors.
        span: Time after which a tick counts 1/e [s].
    """

    def __init__(self, channels: Channels, span: float) -> None:
        self._channels, self._span = channels, span
        self._squares = np.zeros(len(channels.bpms))
        self._weights = np.zeros(len(channels.bpms))
        self._valid: Mask = np.zeros(len(channels.bpms), dtype=np.bool_)
        self._stamp = math.nan
        self._changes = self._dithers = self._ticks = 0.0

    def add(self, record: TickRecord) -> None:
        """Take a record; called in the loop's thread."""
        if record.reading is None:
            return
        orbit = record.reading.orbit
        passed = orbit.time - self._stamp
        kept = math.exp(-max(passed, 0.0) / self._span) if math.isfinite(passed) else 0.0
        error = orbit.position - record.reference
        self._squares *= kept
        self._weights *= kept
        self._squares += np.where(orbit.valid, error, 0.0) ** 2
        self._weights += orbit.valid
        self._valid, self._stamp = orbit.valid, orbit.time
        dither = record.dither * record.scale if np.any(record.applied) else 0.0 * record.dither
        self._changes = kept * self._changes + _mean_square(record.applied)
        self._dithers = kept * self._dithers + _mean_square(dither)
        self._ticks = kept * self._ticks + 1.0

    def copy(self) -> tuple[Vector, float, float]:
        """Copy what is known of late.

        Returns:
            Rms error of every BPM, shape (n,) [m], −1 where it is not known; rms change of a
            setpoint that was written, and the dither's part of it [A].
        """
        known = self._valid & (self._weights > 0.0)
        squares = np.divide(
            self._squares, self._weights, out=np.ones_like(self._squares), where=known
        )
        errors = np.where(known, np.sqrt(squares), -1.0)
        if not self._ticks:
            return errors, math.nan, math.nan
        return (
            errors,
            math.sqrt(self._changes / self._ticks),
            math.sqrt(self._dithers / self._ticks),
        )


def worst(values: Vector, names: tuple[str, ...], planes: str) -> tuple[Ranked, ...]:
    """Name the largest values, largest first.

    Args:
        values: Shape (n,), x first, then y; negative and NaN: not known.
        names: The n names.
        planes: `x`, `y` or `xy`.
    """
    own = -(-len(names) // len(planes))
    known = np.where(values >= 0.0, values, -1.0)
    order = np.argsort(-known, kind="stable")[:SHOWN]
    return tuple(
        Ranked(names[at], planes[at // own], float(values[at])) for at in order if known[at] >= 0.0
    )


def _mean_square(vector: Vector) -> float:
    return float(vector @ vector) / len(vector) if len(vector) else 0.0
