"""Replay a record under several models with one floor and one set of healthy errors.

Models are compared by what they predict of the readings, so the noise of the readings, which no
model predicts, is the same for all of them: differences between models do not suffer from it.
"""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.bent import straightened
from orbitfb.diagnose.explain import Cause, actuated, columns_of, explain, restored
from orbitfb.diagnose.fading import likeliest_steps
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.diagnose.standing import first_kicks
from orbitfb.effects.device_kinds import PairKind, SensorKind
from orbitfb.physics.optics import Matrix
from orbitfb.records.record import Record

_PASSES = 2
_HEALTHY = 3.0
"""Most that an error may be, in units of the healthy scatter, to count as healthy."""
_NUDGE = 1e-6
"""Change of a reading that shows what restoring makes of it [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """What may predict a record.

    Args:
        causes: In the model beside the nominal response.
        change: Added to the nominal response, shape (n, m) [m/A]; None: nothing.
        orbit: Added to the predicted orbit of a record, shape (N, n) [m]; None: nothing.
    """

    causes: tuple[Cause, ...] = ()
    change: Matrix | None = None
    orbit: Matrix | None = None


NOMINAL = Model()


class Replay:
    """A record with the noise floor and the healthy errors that all models share.

    Args:
        record: What happened.
        floor: The noise.
        orbit: Predicted orbit at the BPMs, shape (N, n) [m].
        healthy: Orbit that the healthy errors of gains and gradients add, shape (N, n) [m].
    """

    def __init__(self, record: Record, floor: NoiseFloor, orbit: Matrix, healthy: Matrix) -> None:
        self.record, self.floor, self.orbit, self.healthy = record, floor, orbit, healthy
        rows = np.arange(len(record))
        self._age = rows - np.maximum.accumulate(np.where(record.starts, rows, 0))

    @classmethod
    def of(cls, bench: Bench) -> "Replay":
        """The record of a bench, with what its causes leave."""
        healthy = bench.background.orbit(_healthy(bench.sizes))
        return cls(bench.record, bench.floor, bench.orbit, healthy)

    @classmethod
    def later(cls, bench: Bench, causes: tuple[Cause, ...], record: Record) -> "Replay":
        """Another record, judged with floor and healthy errors of the bench's record.

        Args:
            bench: Under the causes that were found.
            causes: These, as they act in the other record.
            record: Of the same devices; nothing is fitted to it.
        """
        currents = actuated(record, causes)
        if (errors := bench.record.layout.healthy) is not None and record.layout.healthy is None:
            record = straightened(record, errors, currents)
        orbit, healthy = record.readings, np.zeros_like(record.readings)
        for _ in range(_PASSES):
            left = explain(record, causes, orbit).left - healthy
            innovation, _ = bench.floor.innovations(left, record.starts)
            orbit = record.readings - bench.floor.to_bpms(innovation)
            around = bench.background.elsewhere(currents, orbit, record.starts)
            healthy = around.orbit(_healthy(bench.sizes))
        return cls(record, bench.floor, orbit, healthy)

    @property
    def deviation(self) -> Vector:
        """Steady standard deviation of every mode's innovation, shape (n,) [m]."""
        return np.sqrt(self.floor.innovation_variance)

    def counted(self, steps: int = 1) -> Mask:
        """Rows that can be predicted so many steps ahead, shape (N,)."""
        return self._age >= steps

    def white(self, model: Model) -> Matrix:
        """Innovations of unit variance in the modes, of restored readings, shape (N, n)."""
        return self.floor.whiten(self._left(model), self.record.starts)

    def jacobian(self, model: Model) -> Matrix:
        """Log |∂restored/∂reading| by row and BPM, shape (N, n); its sum over a row is exact."""
        total = np.zeros_like(self.record.readings)
        for index, cause in enumerate(model.causes):
            if isinstance(cause.kind, SensorKind):
                columns = columns_of(cause, total.shape[1])
                total[:, columns] += self._own_jacobian(model, index)[:, None] / len(columns)
        total[self.record.starts] = 0.0
        return total

    def errors(self, model: Model, steps: int = 1) -> Matrix:
        """Errors of predicted readings, the logged setpoints replayed from a filtered state.

        The state is not changed after the tick from which the prediction starts.

        Args:
            model: What predicts.
            steps: Ticks ahead.

        Returns:
            Reading − prediction, shape (N, n) [m]; zero in rows that are not `counted`.
        """
        left = self._left(model)
        innovation, _ = self.floor.innovations(left, self.record.starts)
        z = self.floor.to_modes(left)
        ahead = innovation.copy()
        back = steps - 1
        if back:
            ahead[back:] = z[back:] - z[:-back] + innovation[:-back]
        ahead[~self.counted(steps)] = 0.0
        errors = self._as_read(model, self.floor.to_bpms(ahead))
        errors[~self.counted(steps)] = 0.0
        return errors

    def floor_variance(self, steps: int = 1) -> float:
        """Mean square that noise and drift alone leave so many steps ahead [m²]."""
        gains = self.floor.gains
        modes = self.floor.reading * (1.0 + gains) + steps * self.floor.walk
        return self.floor.mean_square(modes)

    def _left(self, model: Model) -> Matrix:
        left = explain(self.record, model.causes, self.orbit).left - self.healthy
        if model.change is not None:
            left -= actuated(self.record, model.causes) @ model.change.T
        if model.orbit is not None:
            left -= model.orbit
        onsets, kicks = first_kicks(model.causes, self.record.layout)
        if len(onsets):
            left -= likeliest_steps(self.floor, self.record.starts, onsets, kicks, left)
        return left

    def _own_jacobian(self, model: Model, index: int) -> Vector:
        """Of one sensors' cause, acting on what the later ones leave, shape (N,)."""
        with_it = restored(self.record, model.causes[index:])[1]
        return with_it - restored(self.record, model.causes[index + 1 :])[1]

    def _as_read(self, model: Model, errors: Matrix) -> Matrix:
        """Turn errors of restored readings into those of readings."""
        for index, cause in enumerate(model.causes):
            kind = cause.kind
            if isinstance(kind, SensorKind):
                columns = columns_of(cause, errors.shape[1])
                before, at = self._nudged(kind, cause, columns)
                if before:
                    errors[:, columns] = self._delayed(model, cause, columns, errors)
                else:
                    shrunk = np.exp(-self._own_jacobian(model, index) / len(columns))
                    shrunk[cause.onset :] *= at
                    errors[:, columns] *= shrunk[:, None]
            elif isinstance(kind, PairKind) and kind.target == "bpm":
                pairs = kind.pairs(self.record.layout)
                matrices = kind.matrices(self.record.layout, cause.values)
                before = errors.copy()
                for place in cause.places:
                    errors[cause.onset :, pairs[place]] = (
                        before[cause.onset :, pairs[place]] @ matrices[place].T
                    )
        return errors

    def _nudged(self, kind: SensorKind, cause: Cause, columns: list[int]) -> tuple[bool, float]:
        """Whether a reading changes what is restored before it, and the sign with which it does."""
        readings = self.record.readings[cause.onset :, columns]
        own = self.record.rows(cause.onset, len(self.record))
        row = len(readings) // 2
        nudged = readings.copy()
        nudged[row] += _NUDGE
        moved = (
            kind.restore(nudged, cause.values, own)[0]
            - kind.restore(readings, cause.values, own)[0]
        )
        return bool(np.any(moved[:row] != 0.0)), float(-1.0 if np.sum(moved[row]) < 0.0 else 1.0)

    def _delayed(self, model: Model, cause: Cause, columns: list[int], errors: Matrix) -> Matrix:
        """Errors where readings are late: the predicted orbit is made late as they are."""
        kind = cause.kind
        if not isinstance(kind, SensorKind):
            return errors[:, columns]
        orbit = restored(self.record, model.causes)[0] - errors
        own = self.record.rows(cause.onset, len(self.record))
        orbit[cause.onset :, columns] -= kind.heard(
            self.orbit[cause.onset :, columns], cause.values, own
        )
        told = kind.distort(orbit[cause.onset :, columns], cause.values, own)
        late = errors[:, columns].copy()
        late[cause.onset :] = self.record.readings[cause.onset :, columns] - told
        return late


def _healthy(sizes: Vector) -> Vector:
    """Sizes of the background as far as they are healthy: a wrong cause drives them far out."""
    return np.clip(sizes, -_HEALTHY, _HEALTHY)
