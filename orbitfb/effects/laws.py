"""Laws: what an effect adds to the readings, as patterns over the BPMs times courses in time.

The diagnosis knows effects only by these forms. A law is one of

* `DeviceLaw`: Σ over devices of pattern ⊗ course, the course known for given values;
* `PairLaw`: the same with courses that two devices exchange;
* `FieldLaw`: one orbit course of the whole ring;
* `RandomLaw`: a pattern whose amplitude is random, with a known spectrum;
* `EventLaw`: a known change that strikes single rows, nobody knows which;
* `ElementsLaw`: a row or a column of the response in which every element is wrong for itself.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Mask, Vector
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.record import Record

Values = Mapping[str, float]


def _nothing(strokes: Vector) -> Values:
    """No parameter that strokes tell themselves."""
    return {}


@dataclass(frozen=True, slots=True, eq=False)
class Signals:
    """What a law acts on.

    Args:
        record: In question.
        currents: That act on the beam as far as is known, shape (N, m) [A].
        orbit: Predicted from the rows before, without the noise of the reading, shape (N, n) [m].
    """

    record: Record
    currents: Matrix
    orbit: Matrix

    def since(self, row: int) -> "Signals":
        """The same from a row on."""
        if row == 0:
            return self
        record = self.record.rows(row, len(self.currents))
        return Signals(record, self.currents[row:], self.orbit[row:])


@dataclass(frozen=True, slots=True, eq=False)
class DeviceLaw:
    """Σ_d Σ_blocks pattern_d ⊗ course_d.

    Args:
        patterns: Orbit per unit of the course, a block per plane, each of shape (n, D) [m].
        course: Courses of all D devices for given values, a block per block of patterns, each of
            shape (N, D), or (N, 1) when it is the same for all.
        names: Of the devices, D of them.
        groups: Devices that are commonly struck together, by name.
        periodic: Whether the course is a wave whose frequency is to be found.
        standing: Whether it acts on an orbit of which the record tells only the changes: where it
            begins in the middle of a record its first kick has any size.
        first: What each device adds in a row if it begins there, shape (N, D): a supply that trips
            loses its whole current at once, one that hangs nothing. None: nobody knows, as where
            it acts on an orbit.
        driven: Whether the courses follow from the currents alone, whatever the orbit is.
        fresh: Whether it has to be followed anew from where it begins: what has a threshold never
            forgets where it was before. What does forget may have been there before the record.
        some: Signals of some devices alone, of which `course` and `first` tell what these do; None
            where that does not follow from their own columns.
        many: Courses of all devices for several sets of values at once, shape (N, V · D); None
            where that is no quicker than one after the other.
        undone: What undoing the law takes off the readings of some BPMs, shape (N, k) [m], and the
            log of the factor by which that widens the density of every row, shape (N,); None of a
            law that no change of the readings undoes.
        lacks: What a record does not show of the law that makes it this one, since a row; empty if
            it lacks nothing. None of a law that is never another one.
    """

    patterns: tuple[Matrix, ...]
    course: Callable[[Values, Signals], tuple[Matrix, ...]]
    names: tuple[str, ...]
    groups: Mapping[str, Indices] = field(default_factory=dict)
    periodic: bool = False
    standing: bool = False
    first: Callable[[Values, Signals], Matrix] | None = None
    driven: bool = False
    fresh: bool = False
    some: Callable[[Signals, Indices], Signals] | None = None
    many: Callable[[Sequence[Values], Signals], Matrix] | None = None
    undone: Callable[[Values, Signals, Indices], tuple[Matrix, Vector]] | None = None
    lacks: Callable[[Values, Signals, int], str] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PairLaw:
    """For a pair (i, j): Σ mixing_kl pattern_k ⊗ course_l over its columns k, l.

    Currents are mixed as they are set, by matrix − 1. Readings are mixed back, by 1 − matrix⁻¹:
    what they show of a wandering orbit and their noise are exchanged, too.

    Args:
        patterns: Of every column, shape (n, D) [m].
        courses: Of every column: as wanted, or as read, shape (N, D).
        pairs: Columns that may be tied, shape (P, 2).
        mixing: Of every pair for given values, shape (P, 2, 2).
        names: Of the columns.
        struck: Columns at fault of every pair, P of them.
        readings: Whether the columns are readings.
    """

    patterns: Matrix
    courses: Matrix
    pairs: Indices
    mixing: Callable[[Values], Matrix]
    names: tuple[str, ...]
    struck: Sequence[tuple[int, ...]]
    readings: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class FieldLaw:
    """One orbit course, shape (N, n) [m], of given values."""

    course: Callable[[Values, Signals], Matrix]


@dataclass(frozen=True, slots=True, eq=False)
class RandomLaw:
    """Amplitudes that are random from row to row: patterns b with covariance κ(λ) b bᵀ of steps.

    Args:
        patterns: Shape (n, D) [m or 1].
        names: Of the D places.
        groups: Places that commonly share the same κ but not the same amplitude.
        walk: Whether every stroke stays (κ is flat in λ) or is gone at the next row (κ λ).
        together: Whether all places of it have it at once only.
        rare: Whether the strokes are few and large.
        relative: Whether its size is told as a ratio to the reading noise of the same BPM.
        lag: Rows between the readings whose covariance it changes.
        smooth: Whether its course is smooth: the variance of its steps then goes with 1/λ.
        size: First parameter that belongs to a κ, for BPMs of a given noise rms [m].
        strokes: Parameters that belong to strokes of every step, zero where there is none.
    """

    patterns: Matrix
    names: tuple[str, ...]
    groups: Mapping[str, Indices]
    walk: bool
    together: bool
    rare: bool
    relative: bool
    lag: int
    size: Callable[[float, float], float]
    smooth: bool = False
    strokes: Callable[[Vector], Values] = _nothing


@dataclass(frozen=True, slots=True, eq=False)
class EventLaw:
    """Rows that are struck: the reading changes by strength · shape at that row alone.

    Args:
        shapes: Change by a strike of strength 1, shape (N, n) [m].
        parts: What may be struck for itself: columns of the readings by name (BPMs), or changes
            of currents by name (correctors); empty: all at once only.
        moves: Change of every corrector's current by a strike, shape (N, m) [A]; zero of a sensor.
        often: Whether every row is struck; else some are.
        single: Whether every BPM is struck for itself.
    """

    shapes: Matrix
    parts: Mapping[str, Indices]
    moves: Matrix
    often: bool
    single: bool


@dataclass(frozen=True, slots=True, eq=False)
class ElementsLaw:
    """Elements of the response of single devices that are wrong, each by an amount of its own.

    Args:
        names: Of the devices, D of them.
        others: Names of the columns that a device has an element with, E of them.
        there: Which elements the model has, shape (D, E).
        scale: Rms of the model's elements of a device, shape (D,) [m/A].
        rows: Whether the devices are BPMs with a row each; else correctors with a column each.
    """

    names: tuple[str, ...]
    others: tuple[str, ...]
    there: Mask
    scale: Vector
    rows: bool


Law = DeviceLaw | PairLaw | FieldLaw | RandomLaw | EventLaw | ElementsLaw


def blocks(courses: NDArray[np.float64]) -> tuple[Matrix, ...]:
    """Courses by plane (2, N, D) as two blocks, others as one."""
    return (courses[0], courses[1]) if courses.ndim == 3 else (courses,)


def of_planes(patterns: Matrix, planes: tuple[str, ...], parted: bool) -> tuple[Matrix, ...]:
    """Patterns as one block, or parted by the plane of the BPM."""
    if not parted:
        return (patterns,)
    rows = np.array(planes)[:, None]
    return (np.where(rows == "x", patterns, 0.0), np.where(rows == "y", patterns, 0.0))
