"""What a set of causes leaves of a record: readings restored, less the orbit that is predicted."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.kinds import (
    ActuatorKind,
    EffectKind,
    PairKind,
    RingKind,
    SensorKind,
    SourceKind,
    Values,
)
from orbitfb.effects.record import Record
from orbitfb.physics.optics import Matrix


@dataclass(frozen=True, slots=True, eq=False)
class Cause:
    """One effect with its place and size.

    Args:
        kind: What it is.
        places: Columns, pairs (of a `PairKind`) or places (of a `SourceKind`); empty for a ring.
        values: All parameters, SI.
        onset: Row from which on it acts.
    """

    kind: EffectKind
    places: tuple[int, ...]
    values: Values
    onset: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Leftover:
    """What a model leaves of a record.

    Args:
        left: Restored reading − prediction, shape (N, n) [m].
        log_jacobian: log |∂restored/∂reading| of every row, shape (N,).
    """

    left: Matrix
    log_jacobian: Vector


def explain(record: Record, causes: Sequence[Cause], orbit: Matrix) -> Leftover:
    """Take from a record what its model with these causes predicts.

    Args:
        record: What happened.
        causes: Applied stage by stage, in this order within a stage.
        orbit: Predicted orbit at the BPMs, free of the noise of the readings of its row, (N, n)
            [m]; what effects that depend on the orbit use.
    """
    currents = actuated(record, causes)
    left, log_jacobian = restored(record, causes)
    left = left - currents @ record.layout.response.T
    for cause in causes:
        if isinstance(cause.kind, SourceKind | RingKind):
            left[cause.onset :] -= added(record, cause, currents, orbit)[cause.onset :]
    return Leftover(left, log_jacobian)


def actuated(record: Record, causes: Sequence[Cause]) -> Matrix:
    """Currents that act on the beam under these causes, shape (N, m) [A]."""
    currents = record.setpoints
    for cause in causes:
        kind, tail = cause.kind, slice(cause.onset, None)
        if isinstance(kind, ActuatorKind):
            currents = currents.copy()
            columns = list(cause.places)
            later = record if cause.onset == 0 else record.rows(cause.onset, len(record))
            currents[tail, columns] = kind.drive(currents[tail, columns], cause.values, later)
        elif isinstance(kind, PairKind) and kind.target == "corrector":
            currents = _tied(kind, cause, currents, record, inverse=False)
    return currents


def restored(record: Record, causes: Sequence[Cause]) -> tuple[Matrix, Vector]:
    """Readings with the sensors' causes undone (the last one first), and the log-Jacobian."""
    readings, log_jacobian = record.readings, np.zeros(len(record))
    for cause in reversed(causes):
        kind, tail = cause.kind, slice(cause.onset, None)
        if isinstance(kind, SensorKind):
            readings = readings.copy()
            columns = list(cause.places)
            later = record if cause.onset == 0 else record.rows(cause.onset, len(record))
            undone, jacobian = kind.restore(readings[tail, columns], cause.values, later)
            readings[tail, columns] = undone
            log_jacobian[tail] += jacobian
        elif isinstance(kind, PairKind) and kind.target == "bpm":
            readings = _tied(kind, cause, readings, record, inverse=True)
    return readings, log_jacobian


def added(record: Record, cause: Cause, currents: Matrix, orbit: Matrix) -> Matrix:
    """Orbit that a source or an effect on the whole ring would add all the time, shape (N, n)."""
    kind = cause.kind
    if isinstance(kind, RingKind):
        return kind.deflect(cause.values, record, currents, orbit)
    if not isinstance(kind, SourceKind):
        return np.zeros_like(record.readings)
    drivers = kind.drivers(cause.values, record, currents, orbit)
    places = list(cause.places)
    patterns = kind.patterns(record.layout)[:, places]
    return shaped(record, drivers, places, patterns)


def shaped(record: Record, drivers: Matrix, places: list[int], patterns: Matrix) -> Matrix:
    """Sum pattern · driver over places, with one driver per plane where there are two."""
    if drivers.ndim == 2:
        moving = drivers if drivers.shape[1] == 1 else drivers[:, places]
        if moving.shape[1] == 1:
            return moving * patterns.sum(axis=1)
        return moving @ patterns.T
    orbit = np.zeros_like(record.readings)
    for plane, driver in zip(("x", "y"), drivers, strict=True):
        rows = record.layout.bpms.in_plane(plane)
        moving = np.broadcast_to(driver, (len(record), max(driver.shape[1], 1)))
        moving = moving if moving.shape[1] == 1 else moving[:, places]
        orbit[:, rows] = (
            moving * patterns[rows].sum(axis=1)
            if moving.shape[1] == 1
            else moving @ patterns[rows].T
        )
    return orbit


def _tied(
    kind: PairKind, cause: Cause, columns: Matrix, record: Record, *, inverse: bool
) -> Matrix:
    matrix = kind.matrix(cause.values)
    if inverse:
        matrix = np.linalg.inv(matrix)
    changed = columns.copy()
    pairs = kind.pairs(record.layout)
    for place in cause.places:
        pair = pairs[place]
        changed[cause.onset :, pair] = columns[cause.onset :, pair] @ matrix.T
    return changed
