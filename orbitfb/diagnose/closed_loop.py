"""What the loop makes of the gap: orbit rms predicted without and with the causes, and measured.

The law of the loop is not in the record; it is estimated as a linear one, change = −K (orbit −
reference) + the logged dither, when the requested changes follow such a law closely enough.
Then the loop is simulated with the floor's own noise, drawn anew, on the nominal model and on the
nominal model with the causes that act on currents.
"""

from collections.abc import Sequence

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.answer_blocks import ClosedLoop
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.blocks import Draws, interval
from orbitfb.diagnose.explain import Cause, columns_of
from orbitfb.effects.device_kinds import ActuatorKind
from orbitfb.effects.record import Record
from orbitfb.physics.effect import generator
from orbitfb.physics.optics import Matrix

_RUNS = 4
_FOLLOWS = 0.98
"""Share of the variance of the requested changes that a linear law must explain."""
_RIDGE = 1e-8
_BROKEN = 1e-2
"""Orbit at which a simulated loop counts as lost [m]."""


def closed_loop(bench: Bench, later: Record | None = None, seed: int = 0) -> ClosedLoop:
    """Predict the rms of the orbit about its reference without and with the causes.

    Args:
        bench: The record under the causes that were found.
        later: The record to be predicted; the bench's own when None.
        seed: Of the noise that is drawn.

    Returns:
        The measured rms always; the predictions are null, and the note says why, when the law
        cannot be estimated or a cause does not act as a gain of correctors.
    """
    record = bench.record if later is None else later
    reference = _reference(record)
    squares = 1e12 * np.mean((record.readings - reference) ** 2, axis=1)
    draws = Draws.of(np.ones(len(record), dtype=np.bool_), seed)
    measured = interval(np.sqrt(draws.means(squares)))
    law, follows = linear_law(record)
    note = ""
    if law is None:
        note = f"not computed: a linear law explains {follows:.0%} of the requested changes"
    mended = mended_response(bench.record, bench.causes)
    if mended is None:
        note = note or "not computed with the causes: they are no static change of the response"
    without = None if law is None else _rms(bench, record, law, record.layout.response, seed)
    known = law is not None and mended is not None
    with_causes = _rms(bench, record, law, mended, seed) if known else None
    radius = None if law is None else _radius(record.layout.response, law)
    return ClosedLoop(
        without_um=without,
        with_um=with_causes,
        measured_um=measured.value,
        measured_low=measured.low,
        measured_high=measured.high,
        radius_without=radius,
        radius_with=_radius(mended, law) if known else None,
        note=note,
    )


def linear_law(record: Record) -> tuple[Matrix | None, float]:
    """Estimate K of change = −K (orbit − reference) + dither.

    Returns:
        K, shape (m, n) [A/m], None when changes do not follow such a law; and the share of
        their variance that it explains, on every other ten ticks that it was not fitted to.
    """
    known = np.isfinite(record.requested).all(axis=1)
    change = record.requested - (0.0 if record.dither is None else record.dither)
    error = record.readings - _reference(record)
    fitted = known & ((np.arange(len(record)) // 10) % 2 == 0)
    judged = known & ~fitted
    if fitted.sum() <= error.shape[1] or not np.any(change[judged]):
        return None, 0.0
    law = _ridge(error[fitted], change[fitted])
    left = change[judged] + error[judged] @ law.T
    follows = 1.0 - float(np.sum(left**2) / np.sum(change[judged] ** 2))
    if not follows >= _FOLLOWS:
        return None, max(follows, 0.0)
    return _ridge(error[known], change[known]), follows


def mended_response(record: Record, causes: Sequence[Cause]) -> Matrix | None:
    """The response with the causes, where they are gains of correctors; None where they are not.

    The currents are regressed on the setpoints of the record; a gain leaves nothing.
    """
    response = record.layout.response.copy()
    probe = record.setpoints
    for cause in causes:
        kind = cause.kind
        if not isinstance(kind, ActuatorKind):
            return None
        for column in columns_of(cause, probe.shape[1]):
            course = probe[:, [column]]
            driven = kind.drive(course, cause.values, record)
            moving = course - course.mean()
            size = float(np.sum(moving**2))
            if not size > 0.0:
                return None
            gain = float(np.sum(moving * (driven - driven.mean()))) / size
            rest = driven - driven.mean() - gain * moving
            if np.sum(rest**2) > 1e-6 * size:
                return None
            response[:, column] *= gain
    return response


def _ridge(error: Matrix, change: Matrix) -> Matrix:
    normal = error.T @ error
    normal[np.diag_indices_from(normal)] += _RIDGE * np.trace(normal) / len(normal)
    return -np.linalg.solve(normal, error.T @ change).T.astype(np.float64)


def _reference(record: Record) -> Matrix:
    return np.zeros_like(record.readings) if record.reference is None else record.reference


def _radius(response: Matrix | None, law: Matrix | None) -> float | None:
    """Spectral radius of the loop u ← u − K R u on the correctors."""
    if response is None or law is None:
        return None
    return float(np.max(np.abs(np.linalg.eigvals(np.eye(law.shape[0]) - law @ response))))


def _rms(
    bench: Bench, record: Record, law: Matrix | None, response: Matrix | None, seed: int
) -> float | None:
    """Rms of the simulated readings about the reference [µm]; None when the loop is lost."""
    if law is None or response is None:
        return None
    rng = generator(seed, "diagnose closed loop")
    reference = _reference(record)
    dither = np.zeros_like(record.setpoints) if record.dither is None else record.dither
    floor = bench.floor
    start = record.readings[0] - record.setpoints[0] @ response.T
    squares: list[float] = []
    for _ in range(_RUNS):
        steps = rng.standard_normal(record.readings.shape) * np.sqrt(floor.walk)
        steps[0] = 0.0
        ground = start + floor.to_bpms(np.cumsum(steps, axis=0))
        noise = np.sqrt(floor.reading) * rng.standard_normal(record.readings.shape)
        total, setpoints = 0.0, record.setpoints[0].copy()
        for row in range(len(record)):
            reading = response @ setpoints + ground[row] + noise[row]
            off = reading - reference[row]
            total += float(off @ off)
            if total > _BROKEN**2 * off.size * len(record):
                return None
            setpoints = setpoints - law @ off + _finite(dither[row])
        squares.append(total / record.readings.size)
    return 1e6 * float(np.sqrt(np.mean(squares)))


def _finite(row: Vector) -> Vector:
    return np.where(np.isfinite(row), row, 0.0)
