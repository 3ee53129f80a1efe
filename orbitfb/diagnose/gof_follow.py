"""Whether what is left at a BPM, or at a corrector, follows what another device did before."""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy import stats

from orbitfb.core.signals import Vector
from orbitfb.diagnose.answer_blocks import GoodnessTest
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.gap_maps import rows_ago
from orbitfb.diagnose.ladder import Ladder
from orbitfb.diagnose.result.naming import column_names
from orbitfb.physics.optics import Matrix

BPMS = "BPM that follows another device"
CORRECTORS = "corrector that follows another device"
_LAGS = 3
"""Ticks, from none on, after which it is looked for."""
_TOLERATED = 0.002
"""Share of what another device did that healthy devices may show of it, as orbits."""
_LEVEL = 0.05
"""Share by which limits are wider, for a floor whose level is not quite right."""


def follow_tests(bench: Bench, rate: float) -> tuple[GoodnessTest, ...]:
    """Regress what is left at every device on what every BPM read and every corrector was, late.

    The past of a record says nothing of its innovations if the model is right, whatever the
    feedback makes of it: scores are normal numbers (F. C. Schweppe, IEEE Trans. Inf. Theory 11
    (1965) 61), of somewhat less than unit variance as healthy errors have been fitted.

    Args:
        bench: The record under the causes that were found.
        rate: How often a test may have a flag by chance.
    """
    record = bench.record
    response = record.layout.response
    size = float(np.sqrt(np.mean(response**2)))
    bpms, correctors = (column_names(its) for its in (record.layout.bpms, record.layout.correctors))
    ladder, slope = (
        Ladder(bench.floor, between=True),
        bench.floor.adjoint(bench.white, record.starts),
    )
    courses = list(_courses(bench, size))
    energies = [
        [
            np.sum(level**2, axis=0, dtype=np.float64)
            for level in ladder.filtered(own, record.starts)
        ]
        for own in courses
    ]
    found: list[GoodnessTest] = []
    for name, names, patterns in (
        (BPMS, bpms, np.eye(len(bpms))),
        (CORRECTORS, correctors, response / size),
    ):
        shapes = [np.sum(shape**2, axis=0) for shape in ladder.shapes(patterns)]
        pull = slope @ patterns / _loudness(bench, patterns)
        scores: list[Matrix] = []
        for own, energy in zip(courses, energies, strict=True):
            known = np.sum([np.outer(a, b) for a, b in zip(shapes, energy, strict=True)], axis=0)
            deviation = np.sqrt(known)
            score = np.divide(
                pull.T @ own, deviation, out=np.zeros_like(known), where=deviation > 0.0
            )
            beyond = np.maximum(np.abs(score) - _TOLERATED * deviation, 0.0)
            scores.append(np.sign(score) * beyond)
        found.append(_judged(name, scores, names, (*bpms, *correctors), rate))
    return tuple(found)


def _loudness(bench: Bench, patterns: Matrix) -> Vector:
    """Scatter of what is left along patterns (n, P), at least what the floor says, shape (P,).

    What is loud anyway is no more likely to follow anything.
    """
    seen = bench.floor.seen(patterns)
    size = np.linalg.norm(seen, axis=0)
    along = bench.white[~bench.record.starts] @ seen
    scatter = np.sqrt(np.mean(along**2, axis=0))
    share = np.divide(scatter, size, out=np.ones_like(size), where=size > 0.0)
    return np.maximum(share, 1.0)


def _courses(bench: Bench, size: float) -> Iterator[Matrix]:
    """Orbit at all BPMs and size of all correctors (N, n + m) [m], by the ticks since then.

    At once the orbit is the predicted one: a reading has its own innovation in it.
    """
    record = bench.record
    currents = bench.currents * size
    yield np.hstack([bench.orbit, currents])
    for lag in range(1, _LAGS):
        yield np.hstack([record.readings, currents])[rows_ago(record, lag)]


def _judged(
    name: str, scores: Sequence[Matrix], names: Sequence[str], others: Sequence[str], rate: float
) -> GoodnessTest:
    """Hold the largest of scores, each (places, others), against what chance exceeds at a rate."""
    values = np.array(scores)
    limit = float(stats.norm.isf(rate / (2 * values.size))) * (1.0 + _LEVEL)
    lag, worst, other = map(int, np.unravel_index(int(np.argmax(np.abs(values))), values.shape))
    value = float(values[lag, worst, other])
    note = f"{names[worst]} follows {others[other]}, {_later(lag)}; in standard deviations"
    return GoodnessTest(
        name=name,
        value=value,
        limit=limit,
        flagged=abs(value) > limit,
        note=note,
        nats=0.5 * value**2,
        places=tuple(dict.fromkeys((names[worst], others[other]))),
    )


def _later(lag: int) -> str:
    return ("at once", "a tick later", f"{lag} ticks later")[min(lag, 2)]
