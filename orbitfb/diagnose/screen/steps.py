"""Steps from row to row, within the unbroken stretches of a record."""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.record import Record

SURE = 50.0
"""Log likelihood by which another sign, name or order must win."""

CHANCE = 1e-6
"""Chance by which a repetition is explained, in all of a record, below which it is a finding."""

_FEW_VALUES = 0.1
"""Different readings per row from which a BPM has few values [1]."""
_FEW = 2
"""Correctors that may kick the other way before the whole record is said to be wrong."""
_ONE_WAY = 0.95
"""Share of the model's steps along one pattern above which a BPM has shown one number only."""


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """What changes from a row to the next one.

    Args:
        first: Row before every step, shape (K,).
        orbit: Change of the readings, shape (K, n) [m].
        setpoints: Change of the setpoints, shape (K, m) [A].
        predicted: What the model makes of it, shape (K, n) [m].
    """

    first: Indices
    orbit: Matrix
    setpoints: Matrix
    predicted: Matrix


def inner(record: Record) -> Mask:
    """Tell which rows are followed by another one of their stretch, shape (N - 1,)."""
    return ~record.starts[1:]


def steps_of(record: Record) -> Steps:
    """Take the steps of a record; those with a filled-in reading stand still there."""
    first = np.flatnonzero(inner(record))
    orbit = record.readings[first + 1] - record.readings[first]
    setpoints = record.setpoints[first + 1] - record.setpoints[first]
    predicted = setpoints @ record.layout.response.T
    unknown = record.filled[first + 1] | record.filled[first]
    orbit[unknown] = 0.0
    predicted[unknown] = 0.0
    return Steps(first, orbit, setpoints, predicted)


def runs(mask: Mask) -> list[tuple[int, int]]:
    """Give the first element and the one after the last of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def longest(mask: Mask) -> tuple[int, int]:
    """Give the longest of them; (0, 0) if there is none."""
    return max(runs(mask), key=lambda span: span[1] - span[0], default=(0, 0))


def has_few_values(record: Record) -> bool:
    """Whether most BPMs read the same few values again and again."""
    ordered = np.sort(record.readings, axis=0)
    distinct = (1 + np.count_nonzero(np.diff(ordered, axis=0), axis=0)) / len(ordered)
    return bool(np.median(distinct) < _FEW_VALUES)


def one_way(steps: Steps) -> bool:
    """Whether the correctors hardly moved but in proportion, so that all BPMs step alike."""
    moved = np.linalg.eigvalsh(steps.predicted.T @ steps.predicted)
    return bool(moved[-1] > _ONE_WAY * moved.sum())


def likelier(count: int, left: Vector, left_otherwise: Vector) -> Vector:
    """Log likelihood by which sums of squares win over others, shape as given [nats].

    Args:
        count: Steps in every sum.
        left: What the model leaves as it is.
        left_otherwise: What it leaves otherwise.
    """
    valid = (left > 0) & (left_otherwise > 0)
    ratio = np.divide(left, left_otherwise, out=np.ones_like(left), where=valid)
    return 0.5 * count * np.log(ratio)


def few_turned(steps: Steps, response: Matrix) -> Vector:
    """Squares left at every BPM when a few correctors kick the other way, shape (n,) [m²].

    One that does leaves so much that another order of all of them, or another sign, would leave
    less.

    Args:
        steps: Of the record.
        response: Of the model, shape (n, m) [m/A].
    """
    seen = np.sum(steps.orbit**2, axis=0)
    weights = np.divide(1.0, seen, out=np.zeros_like(seen), where=seen > 0)
    error, kicks = steps.orbit - steps.predicted, 2.0 * steps.setpoints
    size = np.sum(kicks**2, axis=0) * (weights @ response**2)
    for _ in range(_FEW):
        less = size + 2.0 * np.sum((kicks.T @ error) * (response.T * weights), axis=1)
        best = int(np.argmin(less))
        if less[best] >= 0.0:
            break
        error = error + np.outer(kicks[:, best], response[:, best])
        kicks = kicks.copy()
        kicks[:, best] = 0.0
        size[best] = 0.0
    return np.sum(error**2, axis=0)
