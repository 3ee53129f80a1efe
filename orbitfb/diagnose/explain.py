"""What a set of causes leaves of a record: readings restored, less the orbit that is predicted."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.change import source_change
from orbitfb.effects.device_kinds import ActuatorKind, PairKind, SensorKind
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.orbit_kinds import RingKind, SourceKind
from orbitfb.physics.optics import Matrix
from orbitfb.records.record import Record


@dataclass(frozen=True, slots=True, eq=False)
class Cause:
    """One effect with its place and size.

    Args:
        kind: What it is.
        places: Columns, pairs (of a `PairKind`) or places (of a `SourceKind`); empty for a ring.
        values: All parameters, SI; optional ones that are left out have no effect.
        onset: Row from which on it acts.
        free: Whether its step at the onset says nothing: it acts on what changes from then on.
    """

    kind: EffectKind
    places: tuple[int, ...]
    values: Values
    onset: int = 0
    free: bool = False

    def __post_init__(self) -> None:
        spare = {p.name: p.nominal for p in self.kind.parameters if p.optional}
        if not spare.keys() <= self.values.keys():
            object.__setattr__(self, "values", {**spare, **self.values})


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
        if adds(cause.kind):
            left -= added(record, cause, currents, orbit)
    return Leftover(left, log_jacobian)


def columns_of(cause: Cause, count: int) -> list[int]:
    """Columns that a cause acts on: its places, or all of them for an effect without places."""
    return list(range(count)) if cause.kind.target == "ring" else list(cause.places)


def actuated(record: Record, causes: Sequence[Cause], currents: Matrix | None = None) -> Matrix:
    """Currents that act on the beam under these causes, shape (N, m) [A].

    Those of a cause that acts on changes alone go on from what they were at its onset.

    Args:
        record: What happened.
        causes: One after the other.
        currents: Under the causes before them; the setpoints when None.
    """
    currents = record.setpoints if currents is None else currents
    for cause in causes:
        kind, tail, before = cause.kind, slice(cause.onset, None), currents
        if isinstance(kind, ActuatorKind):
            currents = currents.copy()
            columns = columns_of(cause, currents.shape[1])
            driven = kind.drive(
                currents[tail, columns], cause.values, _from(record, kind, cause.onset)
            )
            currents[tail, columns] = driven
        elif isinstance(kind, PairKind) and kind.target == "corrector":
            currents = _tied(kind, cause, currents, record, inverse=False)
        if cause.free and cause.onset and currents is not before:
            currents[tail] -= currents[cause.onset] - before[cause.onset]
    return currents


def restored(record: Record, causes: Sequence[Cause]) -> tuple[Matrix, Vector]:
    """Readings with the sensors' causes undone (the last one first), and the log-Jacobian."""
    readings, log_jacobian = record.readings, np.zeros(len(record))
    for cause in reversed(causes):
        kind, tail = cause.kind, slice(cause.onset, None)
        if isinstance(kind, SensorKind):
            readings = readings.copy()
            columns = columns_of(cause, readings.shape[1])
            undone, jacobian = kind.restore(
                readings[tail, columns], cause.values, _from(record, kind, cause.onset)
            )
            readings[tail, columns] = undone
            log_jacobian[tail] += jacobian
        elif isinstance(kind, PairKind) and kind.target == "bpm":
            readings = _tied(kind, cause, readings, record, inverse=True)
    return readings, log_jacobian


def heard(record: Record, causes: Sequence[Cause], orbit: Matrix) -> Matrix | float:
    """What restored readings still have of sensors' causes, shape (N, n) [m]; 0: nothing."""
    blurring = [c for c in causes if isinstance(c.kind, SensorKind) and c.kind.blurs]
    return sum((added(record, cause, record.setpoints, orbit) for cause in blurring), 0.0)


def adds(kind: EffectKind) -> bool:
    """Whether an effect adds to the predicted orbit, or to what is read of it."""
    return isinstance(kind, SourceKind | RingKind) or (isinstance(kind, SensorKind) and kind.blurs)


def added(record: Record, cause: Cause, currents: Matrix, orbit: Matrix) -> Matrix:
    """What an effect adds to the orbit, or to its restored readings, from its onset on, (N, n)."""
    kind, onset = cause.kind, cause.onset
    orbit_added = np.zeros_like(record.readings)
    if isinstance(kind, SensorKind):
        tail, columns = slice(onset, None), columns_of(cause, orbit.shape[1])
        own = _from(record, kind, onset)
        orbit_added[tail, columns] = kind.heard(orbit[tail, columns], cause.values, own)
    if not isinstance(kind, SourceKind | RingKind):
        return orbit_added
    own = _from(record, kind, onset) if kind.grows else record
    tail = slice(onset, None) if kind.grows else slice(None)
    if isinstance(kind, RingKind):
        change = kind.deflect(cause.values, own, currents[tail], orbit[tail])
    else:
        weights = np.zeros(len(kind.places_of(record.layout)))
        places = np.array(cause.places, dtype=np.intp)
        weights[places] = kind.shares(record.layout, places)
        change = source_change(kind, cause.values, own, currents[tail], orbit[tail], weights)
    orbit_added[onset:] = change if kind.grows else change[onset:]
    return orbit_added


def _from(record: Record, kind: EffectKind, onset: int) -> Record:
    """The record as an effect sees it that begins at a row; one that grows begins from nothing."""
    if onset == 0:
        return record
    later = record.rows(onset, len(record))
    return replace(later, time=later.time - later.time[0]) if kind.grows else later


def _tied(
    kind: PairKind, cause: Cause, columns: Matrix, record: Record, *, inverse: bool
) -> Matrix:
    matrices = kind.matrices(record.layout, cause.values)
    changed = columns.copy()
    pairs = kind.pairs(record.layout)
    for place in cause.places:
        pair, matrix = pairs[place], matrices[place]
        if inverse:
            matrix = np.linalg.inv(matrix)
        changed[cause.onset :, pair] = columns[cause.onset :, pair] @ matrix.T
    return changed
