"""What the effects of correctors share: courses in time, and their parts in the plant.

Row k of a record holds the setpoints in force while reading k came about: they were written
after reading k − 1 and held since. The plant steps in the same way (`Plant.step` gets what is in
force during its tick). A memory therefore moves on by one whole period under the setpoints of
row k before reading k, and a step of a setpoint that first shows in row k already has its first
answer there.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import lfilter

from orbitfb.core.errors import ConfigError
from orbitfb.core.robust import TO_SIGMA
from orbitfb.core.signals import Vector
from orbitfb.effects.kinds import Values
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

_FEW_LARGE = 0.3
"""Usual size of changes over their rms below which few large ones make the rms."""
_NO_PART = 0.004
"""Share of a square that laws which are all a little wrong leave [1]: `MISFIT` of the evidence."""


class ColumnsEffect(Effect, ABC):
    """An effect on some correctors, each for itself; its memory begins at its first tick.

    Args:
        places: Columns of the setpoints that it acts on, shape (k,).
    """

    def __init__(self, places: Indices) -> None:
        self._places = places

    def actuate(self, setpoints: Vector, tick: int) -> Vector:
        """Turn the setpoints of its correctors into what their magnets carry."""
        currents = setpoints.copy()
        currents[self._places] = self.follow(setpoints[self._places])
        return currents

    @abstractmethod
    def follow(self, wanted: Vector) -> Vector:
        """Pass one tick: setpoints in, currents out, both of shape (k,) [A]."""


class PairsEffect(Effect):
    """An effect that mixes the currents of pairs of correctors.

    Args:
        pairs: Columns, shape (P, 2); no column twice as a second one.
        changes: What is added: currents[pair] += changes[pair] @ setpoints[pair], (P, 2, 2).
    """

    def __init__(self, pairs: Indices, changes: Matrix) -> None:
        self._pairs, self._changes = pairs, changes

    def actuate(self, setpoints: Vector, tick: int) -> Vector:
        """Mix."""
        currents = setpoints.copy()
        for pair, change in zip(self._pairs, self._changes, strict=True):
            currents[pair] += change @ setpoints[pair]
        return currents


def couples(places: Indices, name: str) -> Indices:
    """Take places two by two, in the order in which they were given, shape (P, 2).

    Raises:
        ConfigError: They are none, or not an even number.
    """
    if len(places) == 0 or len(places) % 2:
        raise ConfigError(
            f"{name} ties correctors two by two, but has {len(places)} of them; "
            "name the first and the second (of every pair)"
        )
    return np.reshape(places, (-1, 2))


def lacks_motion(courses: Matrix, currents: Matrix) -> str:
    """Say if currents might as well not move: their motion is no part of what they lack.

    Told of the currents themselves, which slow noise hides, and of their changes, as white noise
    does.

    Args:
        courses: What is wanted, shape (N, k).
        currents: What comes of it, shape (N, k).

    Returns:
        The end of a sentence, as `lacks` of a kind tells it; empty: they move.
    """
    lacking = courses - currents
    still = all(
        float(np.var(moved, axis=0).sum()) < _NO_PART * float(np.var(lost, axis=0).sum())
        for moved, lost in (
            (currents, lacking),
            (np.diff(currents, axis=0), np.diff(lacking, axis=0)),
        )
    )
    return "the current never moves" if still else ""


def filtered(courses: Matrix, numerator: Vector, denominator: Vector, record: Record) -> Matrix:
    """Pass every column through a filter of unit gain, from a steady state at every stretch.

    Args:
        courses: Shape (N, k).
        numerator: Coefficients of z⁻⁰, z⁻¹, … of what goes in.
        denominator: Coefficients of what comes out, the first one 1.
        record: Where the stretches begin.

    Returns:
        Shape (N, k).
    """
    passed = np.empty_like(courses)
    for stretch in record.stretches:
        # what departs from the first row starts from rest
        first = courses[stretch.start]
        departure = courses[stretch] - first
        passed[stretch] = first + np.asarray(lfilter(numerator, denominator, departure, axis=0))
    return passed


@dataclass(frozen=True, slots=True)
class Arithmetic:
    """What a law of one column is written with, so that it serves numbers and whole rows alike.

    Args:
        least: The smaller of two.
        most: The larger of two.
        either: The second if the first is true, else the third.
    """

    least: Callable[[Any, Any], Any]
    most: Callable[[Any, Any], Any]
    either: Callable[[Any, Any, Any], Any]


_NUMBERS = Arithmetic(min, max, lambda true, one, other: one if true else other)
_ROWS = Arithmetic(np.minimum, np.maximum, np.where)
_FEW = 12
"""Columns up to which plain numbers, column by column, are quicker than rows of few."""

Law = Callable[[Arithmetic, Any, Any], Any]
"""What comes of what is wanted now and what was held before."""


def followed(
    courses: Matrix,
    record: Record,
    law: Law,
    by_column: bool = False,
    first: Vector | float = 0.0,
    lasts: bool = False,
) -> Matrix:
    """Pass all columns through a memory, row by row; at the start of a stretch it is at rest.

    Args:
        courses: Shape (N, k).
        record: Where the stretches begin.
        law: Of one column.
        by_column: Whether the law has values of every column's own, so that it needs whole rows.
        first: What is held in the first row beyond the courses, one for all or of shape (k,).
        lasts: Whether what is held lasts until it is moved, so that stretches do not end it.

    Returns:
        Shape (N, k).
    """
    held = np.empty_like(courses)
    starts = [True] + [False] * (len(courses) - 1) if lasts else record.starts.tolist()
    beyond = np.broadcast_to(first, courses.shape[1])
    if by_column or courses.shape[1] > _FEW:
        _follow(courses, held, starts, law, _ROWS, beyond)
    else:
        for column, wanted in enumerate(courses.T.tolist()):
            kept = wanted.copy()
            _follow(wanted, kept, starts, law, _NUMBERS, float(beyond[column]))
            held[:, column] = kept
    return held


def _follow(
    wanted: Any, held: Any, starts: list[bool], law: Law, arithmetic: Arithmetic, first: Any
) -> None:
    for row, starting in enumerate(starts):
        held[row] = wanted[row] if starting else law(arithmetic, wanted[row], held[row - 1])
        if row == 0:
            held[row] = held[row] + first


def changes(courses: Matrix, record: Record) -> Matrix:
    """Change of every column since the row before; zero in the first row of a stretch."""
    difference = np.zeros_like(courses)
    difference[1:] = np.diff(courses, axis=0)
    difference[record.starts] = 0.0
    return difference


def ladder(name: str, others: Values, steps: Sequence[float] | Vector) -> tuple[Values, ...]:
    """Sets of values in which one parameter runs and the others stay."""
    return tuple({**others, name: float(step)} for step in steps)


def largest_change(record: Record) -> float:
    """Largest change of a setpoint between two rows [A]; 1 mA when none changes."""
    return float(np.max(np.abs(changes(record.setpoints, record)), initial=0.0)) or 1e-3


def usual_change(record: Record) -> float:
    """Size of the changes of the setpoints between two rows [A]; 1 mA when none changes.

    Their rms, if they are normal; few large ones, as when an orbit is steered away, do not count.
    """
    size = np.abs(changes(record.setpoints, record))
    return TO_SIGMA * float(np.median(size[size > 0.0])) if size.any() else 1e-3


def scales_of_change(record: Record) -> tuple[float, ...]:
    """Rms of the changes of the setpoints [A], and their usual size if few large ones make it."""
    rms = float(np.sqrt(np.mean(changes(record.setpoints, record) ** 2))) or 1e-3
    usual = usual_change(record)
    return (rms, usual) if usual < _FEW_LARGE * rms else (rms,)


def widths(record: Record, top: float) -> Vector:
    """Widths of a dead zone to scan, each half as wide again as the one before [A].

    One that is narrow beside the changes shows by its width alone, however large these are.

    Args:
        record: Its changes tell the narrowest.
        top: The widest [A].
    """
    bottom = min(0.02 * largest_change(record), 0.005 * usual_change(record))
    return np.geomspace(bottom, top, 1 + max(1, round(np.log(top / bottom) / np.log(1.5))))


def largest_setpoint(record: Record) -> float:
    """Largest setpoint, either sign [A]; 1 A when all are zero."""
    return float(np.max(np.abs(record.setpoints), initial=0.0)) or 1.0


def widest_range(record: Record) -> float:
    """Largest range that one setpoint spans over the record [A]; 1 mA when none changes."""
    return float(np.max(np.ptp(record.setpoints, axis=0), initial=0.0)) or 1e-3


def pairs_of(layout: Layout, cells: bool) -> Indices:
    """Ordered pairs of correctors: all of one plane, and the two planes of one device.

    Args:
        layout: The correctors.
        cells: Whether to pair also columns of different planes that share a cell.

    Returns:
        Columns, shape (P, 2).
    """
    devices = layout.correctors
    plane = np.array(devices.planes)
    name, cell = np.array(devices.names), np.array(devices.cells)
    tied = (plane[:, None] == plane) | (name[:, None] == name)
    if cells:
        tied |= (cell[:, None] == cell) & (cell != "")
    np.fill_diagonal(tied, False)
    return np.argwhere(tied)
