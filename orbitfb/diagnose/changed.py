"""How more causes change what a model leaves of a record, without computing all of it again."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.explain import Cause, actuated, added, adds, explain, restored
from orbitfb.effects.device_kinds import ActuatorKind, PairKind, SensorKind
from orbitfb.effects.orbit_kinds import RingKind, SourceKind
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.record import Record


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """What more causes add to what is left.

    Args:
        readings: Columns of the BPMs that change by themselves, shape (N, k) [m].
        bpms: Which ones, shape (k,).
        currents: Columns of the correctors that change, shape (N, c) [A].
        correctors: Which ones, shape (c,); what they take from what is left is R · currents.
        orbit: Whatever else is left more, shape (N, n) [m]; None: nothing.
        log_jacobian: Of all causes, shape (N,).
    """

    readings: Matrix
    bpms: Indices
    currents: Matrix
    correctors: Indices
    orbit: Matrix | None
    log_jacobian: Vector

    def whole(self, response: Matrix) -> Matrix:
        """All of it, shape (N, n) [m].

        Args:
            response: R, shape (n, m) [m/A].
        """
        total = -self.currents @ response[:, self.correctors].T
        total[:, self.bpms] += self.readings
        return total if self.orbit is None else total + self.orbit


class Explained:
    """A record under some causes, to which more are added again and again.

    Args:
        record: What happened.
        causes: That stay.
        orbit: Predicted orbit at the BPMs, shape (N, n) [m].

    Attributes:
        left: Restored reading − prediction, shape (N, n) [m].
        log_jacobian: Of the causes, shape (N,).
    """

    def __init__(self, record: Record, causes: Sequence[Cause], orbit: Matrix) -> None:
        self.record, self.causes, self.orbit = record, tuple(causes), orbit
        self._currents = actuated(record, causes)
        self._readings = restored(record, causes)[0]
        whole = explain(record, causes, orbit)
        self.left, self.log_jacobian = whole.left, whole.log_jacobian

    def change(self, causes: Sequence[Cause]) -> Change:
        """Tell what is left more under more causes."""
        record = self.record
        nothing, none = np.zeros((len(record), 0)), np.zeros(0, np.intp)
        readings, bpms, log_jacobian = nothing, none, self.log_jacobian
        if any(_senses(cause) for cause in causes):
            undone, log_jacobian = restored(record, (*self.causes, *causes))
            readings = undone - self._readings
            bpms = np.flatnonzero(readings.any(axis=0))
            readings = readings[:, bpms]
        moved, correctors, acting = nothing, none, self._currents
        if any(_drives(cause) for cause in causes):
            acting = actuated(record, causes, self._currents)
            moved = acting - self._currents
            correctors = np.flatnonzero(moved.any(axis=0))
            moved = moved[:, correctors]
        orbit: Matrix | None = None
        for cause in causes:
            if adds(cause.kind):
                more = added(record, cause, acting, self.orbit)
                orbit = -more if orbit is None else orbit - more
        if len(correctors):
            # What sources make of the currents changes with them.
            for cause in self.causes:
                if isinstance(cause.kind, SourceKind | RingKind):
                    more = added(record, cause, acting, self.orbit)
                    more -= added(record, cause, self._currents, self.orbit)
                    orbit = -more if orbit is None else orbit - more
        return Change(readings, bpms, moved, correctors, orbit, log_jacobian)


def _senses(cause: Cause) -> bool:
    kind = cause.kind
    return isinstance(kind, SensorKind) or (isinstance(kind, PairKind) and kind.target == "bpm")


def _drives(cause: Cause) -> bool:
    kind = cause.kind
    return isinstance(kind, ActuatorKind) or (
        isinstance(kind, PairKind) and kind.target == "corrector"
    )
