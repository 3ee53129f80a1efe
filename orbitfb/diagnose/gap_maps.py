"""Where the gap sits: scores of the correctors, profile over lags, heat maps."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.answer_blocks import HeatMap, LagProfile
from orbitfb.diagnose.answer_values import Number, numbers, rows
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.gap_parts import band_edges
from orbitfb.diagnose.ladder import Ladder
from orbitfb.diagnose.result.naming import column_names
from orbitfb.diagnose.surplus import Surplus
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.record import Record

_LAGS = 8
_NINETY = 1.645


def corrector_scores(bench: Bench, whole: Surplus, ticks: int) -> dict[str, Number]:
    """Gain of log-likelihood by a gain error of each corrector alone [nats/tick]: a score map."""
    slope, size = projected(bench, whole.nominal, bench.record.setpoints)
    gain = 0.5 * slope**2 / np.maximum(size, 1e-300) / ticks
    return dict(zip(column_names(bench.record.layout.correctors), gain.tolist(), strict=True))


def projected(bench: Bench, white: Matrix, courses: Matrix) -> tuple[Vector, Vector]:
    """Score and information of R_j times a course of every corrector, each of shape (m,)."""
    record, floor = bench.record, bench.floor
    slope = floor.adjoint(white, record.starts) @ record.layout.response
    ladder = Ladder(floor)
    size = np.zeros(courses.shape[1])
    shapes = ladder.shapes(record.layout.response)
    for shape, course in zip(shapes, ladder.filtered(courses, record.starts), strict=True):
        size += np.sum(shape**2, axis=0) * np.sum(course**2, axis=0)
    return np.sum(slope * courses, axis=0), size


def lagged(record: Record, ticks: int) -> Matrix:
    """Setpoints so many ticks ago, those of the first row before a stretch, shape (N, m) [A]."""
    return record.setpoints[rows_ago(record, ticks)]


def rows_ago(record: Record, ticks: int) -> Indices:
    """Row so many ticks before every row, the first of its stretch before that, shape (N,)."""
    index = np.arange(len(record))
    first = np.maximum.accumulate(np.where(record.starts, index, 0))
    return np.maximum(index - ticks, first)


def lag_profile(bench: Bench, whole: Surplus) -> LagProfile:
    """Regress innovations on the orbit that setpoints of earlier ticks make, all lags together.

    Args:
        bench: The record under the causes that were found.
        whole: Its `surplus`: the profile is that of the nominal model, `refit` of the best one.
    """
    record, floor = bench.record, bench.floor
    courses = [
        floor.whiten(lagged(record, lag) @ record.layout.response.T, record.starts)
        for lag in range(_LAGS)
    ]
    normal = np.array([[np.sum(a * b) for b in courses] for a in courses])
    inverse = np.linalg.pinv(normal, hermitian=True, rcond=1e-10)
    slope = inverse @ np.array([np.sum(course * whole.nominal) for course in courses])
    refit = inverse @ np.array([np.sum(course * whole.best) for course in courses])
    error = _NINETY * np.sqrt(np.maximum(np.diagonal(inverse), 0.0))
    return LagProfile(
        lags=tuple(range(1, _LAGS + 1)),
        slope=numbers(slope),
        low=numbers(slope - error),
        high=numbers(slope + error),
        refit=numbers(refit),
    )


def maps(bench: Bench, whole: Surplus) -> tuple[HeatMap, ...]:
    """Map the gap over BPM × frequency, and the scores over corrector × lag.

    Args:
        bench: The record under the causes that were found.
        whole: Its `surplus`.
    """
    record = bench.record
    ticks = max(int(whole.counted.sum()), 1)
    edges = band_edges()
    table = np.array([band.sum(axis=0) for band in whole.by_frequency(edges)]).T / ticks
    frequencies = np.clip(edges[1:], 0.0, 0.5) / record.layout.period
    scores: list[Vector] = []
    for lag in range(_LAGS):
        course = lagged(record, lag) - lagged(record, lag + 1)
        slope, size = projected(bench, whole.nominal, course)
        scores.append(slope / np.sqrt(np.maximum(size, 1e-300)))
    return (
        HeatMap(
            title="Gap by BPM and frequency",
            row_label="BPM",
            column_label="up to this frequency [Hz]",
            values=rows(table),
            unit="nats/tick",
            row_names=column_names(record.layout.bpms),
            columns=numbers(frequencies),
            signed=True,
        ),
        HeatMap(
            title="Innovation along a change of each corrector, lag ticks ago",
            row_label="corrector",
            column_label="lag [ticks]",
            values=rows(np.array(scores).T),
            unit="standard deviations",
            row_names=column_names(record.layout.correctors),
            columns=numbers(np.arange(1.0, _LAGS + 1)),
            signed=True,
        ),
    )
