"""The record that a planned excitation would give, but for noise.

It is made from the last rows of the one at hand: its setpoints, with the excursion and what the
feedback makes of it. The feedback's gain is read off the record, mode by mode of the response.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from orbitfb.core.signals import Vector
from orbitfb.diagnose.background import Background
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.explain import Cause, added, columns_of
from orbitfb.diagnose.healthy_search import HealthySearch
from orbitfb.diagnose.quick import Quick
from orbitfb.effects.device_kinds import ActuatorKind, PairKind, SensorKind
from orbitfb.effects.orbit_kinds import RingKind, SourceKind
from orbitfb.physics.optics import Matrix
from orbitfb.records.record import Record

ROWS = 400
"""Rows that are simulated for a candidate."""


@dataclass(frozen=True, slots=True, eq=False)
class Outlook:
    """A record that an excitation would give, but for noise.

    Args:
        record: With predicted readings.
        bench: Of the record at hand; its floor counts.
        errors: Healthy errors of the ring in it; None: those of the gains of the devices alone,
            which is many times as fast.
    """

    record: Record
    bench: Bench
    errors: HealthySearch | None = None

    def white(self, cause: Cause | None) -> Matrix:
        """Change of the innovations by a cause, shape (N, n); zero for none."""
        if cause is None:
            return np.zeros_like(self.record.readings)
        return self.bench.floor.whiten(predicted(self.record, cause), self.record.starts)


def outlook(
    bench: Bench,
    excursion: Matrix,
    gains: Vector | None = None,
    *,
    exact: bool = False,
) -> Outlook:
    """Simulate the record that an excitation would give.

    Args:
        bench: The record at hand.
        excursion: Around the setpoints of the feedback, shape (T, m) [A]; T at most as many as
            `base_rows` gives.
        gains: Of the feedback by mode, from `loop_gains`; computed when None.
        exact: Whether all healthy errors of the ring are to count.
    """
    record, response = bench.record, bench.record.layout.response
    longest = max(record.stretches, key=lambda part: part.stop - part.start)
    begin = longest.stop - len(excursion)
    moved = answered(excursion, response, loop_gains(record) if gains is None else gains)
    base = record.rows(begin, longest.stop)
    orbit = bench.orbit[begin : longest.stop] + moved @ response.T
    record = replace(base, readings=orbit, setpoints=base.setpoints + moved)
    if not exact:
        return Outlook(record, bench)
    own = Background(record.layout, record.setpoints, orbit, record.starts, bench.scale)
    own.prepare(bench.floor)
    return Outlook(record, bench, HealthySearch(Quick(bench.floor, record.starts), own))


def base_rows(record: Record) -> int:
    """Tell how many rows a simulated excitation may have."""
    return min(ROWS, *(max(part.stop - part.start for part in record.stretches),))


def loop_gains(record: Record) -> Vector:
    """Read the feedback's gain off a record: share of each mode's orbit taken back in a tick.

    Returns:
        Shape (min(n, m),), from 0 to 1.
    """
    left, size, right = np.linalg.svd(record.layout.response, full_matrices=False)
    known = np.isfinite(record.requested).all(axis=1)
    error = record.readings if record.reference is None else record.readings - record.reference
    asked = record.requested if record.dither is None else record.requested - record.dither
    orbit, change = error[known] @ left, asked[known] @ right.T
    power = np.sum(orbit**2, axis=0)
    slope = -np.sum(orbit * change, axis=0) / np.maximum(power, 1e-300)
    return np.clip(slope * size, 0.0, 1.0)


def answered(excursion: Matrix, response: Matrix, gains: Vector) -> Matrix:
    """Add what the feedback does against an excursion to it, shape (T, m) [A]."""
    modes = np.linalg.svd(response, full_matrices=False)[2]
    wanted = excursion @ modes.T
    moved = excursion.copy()
    change = np.zeros_like(wanted)
    for mode, gain in enumerate(gains):
        # u_k = d_k + c_k and c_{k+1} = c_k − g u_k: c_{k+1} = (1 − g) c_k − g d_k
        course = lfilter([0.0, -gain], [1.0, gain - 1.0], wanted[:, mode])
        change[:, mode] = course
    return moved + change @ modes


def predicted(record: Record, cause: Cause) -> Matrix:
    """Change of the predicted readings by a cause from the first row on, shape (N, n) [m]."""
    kind, currents, orbit = cause.kind, record.setpoints, record.readings
    change = np.zeros_like(orbit)
    if isinstance(kind, ActuatorKind):
        columns = columns_of(cause, currents.shape[1])
        moved = kind.drive(currents[:, columns], cause.values, record) - currents[:, columns]
        return moved @ record.layout.response[:, columns].T
    if isinstance(kind, SensorKind):
        columns = columns_of(cause, orbit.shape[1])
        change[:, columns] = kind.distort(orbit[:, columns], cause.values, record)
        change[:, columns] -= orbit[:, columns]
    elif isinstance(kind, PairKind):
        pairs, matrices = kind.pairs(record.layout), kind.matrices(record.layout, cause.values)
        corrector = kind.target == "corrector"
        before = currents if corrector else orbit
        moved = np.zeros_like(before)
        for place in cause.places:
            tied = pairs[place]
            moved[:, tied] += before[:, tied] @ (matrices[place] - np.eye(2)).T
        change = moved @ record.layout.response.T if corrector else moved
    elif isinstance(kind, SourceKind | RingKind):
        change = added(record, replace(cause, onset=0), currents, orbit)
    return change
