"""What every BPM and every corrector did of late: the worst of them, and how much was moved."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Channels, Mask, TickRecord, Vector

SHOWN = 5
"""How many BPMs and correctors are told by name."""


_BLOCKS = 10
"""Parts in which a window moves on."""


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


@dataclass(slots=True)
class _Block:
    begin: float
    squares: Vector
    counts: Vector
    ticks: int = 0
    change: float = 0.0
    dither: float = 0.0


class Averages:
    """Means over the last ticks: a few vector operations for each.

    Args:
        channels: Names behind the vectors.
        span: How far back [s].
    """

    def __init__(self, channels: Channels, span: float) -> None:
        self._size, self._span = len(channels.bpms), span
        self._blocks: deque[_Block] = deque()
        self._valid: Mask = np.zeros(self._size, dtype=np.bool_)

    def add(self, record: TickRecord) -> None:
        """Take a record; called in the loop's thread."""
        if record.reading is None:
            return
        orbit, blocks = record.reading.orbit, self._blocks
        while blocks and not 0.0 <= orbit.time - blocks[0].begin < self._span:
            blocks.popleft()
        if not blocks or orbit.time - blocks[-1].begin >= self._span / _BLOCKS:
            blocks.append(_Block(orbit.time, np.zeros(self._size), np.zeros(self._size)))
        self._valid = orbit.valid
        block = blocks[-1]
        block.squares += np.where(orbit.valid, orbit.position - record.reference, 0.0) ** 2
        block.counts += orbit.valid
        block.ticks += 1
        if record.applied.any():
            block.change += _mean_square(record.applied)
            block.dither += _mean_square(record.dither * record.scale)

    def copy(self) -> tuple[Vector, float, float]:
        """Copy what is known of late.

        Returns:
            Rms error of every BPM, shape (n,) [m], −1 where it is not known; rms change of a
            setpoint that was written, and the dither's part of it [A].
        """
        errors = np.full(self._size, -1.0)
        if not self._blocks:
            return errors, math.nan, math.nan
        squares = np.sum([block.squares for block in self._blocks], axis=0)
        counts = np.sum([block.counts for block in self._blocks], axis=0)
        known = self._valid & (counts > 0)
        errors[known] = np.sqrt(squares[known] / counts[known])
        ticks = sum(block.ticks for block in self._blocks)
        change = sum(block.change for block in self._blocks) / ticks
        dither = sum(block.dither for block in self._blocks) / ticks
        return errors, math.sqrt(change), math.sqrt(dither)


def worst(values: Vector, names: tuple[str, ...], planes: tuple[str, ...]) -> tuple[Ranked, ...]:
    """Name the largest values, largest first.

    Args:
        values: Shape (n,), x first, then y; negative and NaN: not known.
        names: The n names.
        planes: Of each of them.
    """
    known = np.where(values >= 0.0, values, -1.0)
    order = np.argsort(-known, kind="stable")[:SHOWN]
    return tuple(
        Ranked(names[at], planes[int(at)], float(values[at])) for at in order if known[at] >= 0.0
    )


def _mean_square(vector: Vector) -> float:
    return float(vector @ vector) / len(vector) if len(vector) else 0.0
