"""What a model of any kind could gain: the ceiling of every explanation, on held-out ticks.

A generic discrepancy: families of linear terms (the change of every corrector now and one tick
ago; the change of the orbit at every BPM, and its square; a ramp at every BPM), each with a
coefficient per device and one common to all. A family's coefficients are normal;
their width is what makes the ticks that are fitted most likely (an empirical Bayes ridge), so a
family that is of no use stays out by itself. Fitted to every other block of ticks, judged on the
rest, and the other way round. It is a yardstick and never offered as a cause.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.blocks import BLOCK, Draws, Interval, interval
from orbitfb.diagnose.gap_maps import lagged
from orbitfb.diagnose.ladder import Ladder
from orbitfb.physics.optics import Matrix

_LEVELS = 6
_WIDTHS = np.geomspace(1e-3, 1e3, 25)
"""Prior widths, in units of what one device's coefficient is known to without a prior."""


@dataclass(frozen=True, slots=True, eq=False)
class Ceiling:
    """The generic discrepancy of a record.

    Args:
        white: Innovations with it, of ticks that it was not fitted to, shape (N, n).
        nats: Its held-out gain over the causes [nats].
    """

    white: Matrix
    nats: Interval

    @property
    def resolved(self) -> bool:
        """Whether there is something left to explain."""
        return self.nats.resolved


def ceiling(bench: Bench, seed: int = 0) -> Ceiling:
    """Measure what is left to be explained.

    Args:
        bench: The record under the causes that were found.
        seed: Of the bootstrap.
    """
    counted = ~bench.record.starts
    even = (np.arange(len(bench.record)) // BLOCK) % 2 == 0
    halves = (even, ~even)
    ladder = Ladder(bench.floor, _LEVELS)
    left = [bench.white.copy(), bench.white.copy()]
    for patterns, courses in _families(bench):
        shapes = ladder.shapes(patterns)
        filtered = ladder.filtered(courses, bench.record.starts)
        for index, half in enumerate(halves):
            kept = half & counted
            info = _masked(shapes, filtered, kept)
            slope = bench.floor.adjoint(left[index] * kept[:, None], bench.record.starts)
            score = np.sum((slope @ patterns) * courses, axis=0)
            coefficients = _coefficients(info, score)
            if np.any(coefficients):
                change = (courses * coefficients) @ patterns.T
                moved = bench.floor.whiten(change, bench.record.starts)
                # The ladder's information is not exact: no step goes beyond the best one.
                best = np.sum((moved * left[index])[kept]) / np.sum(moved[kept] ** 2)
                left[index] -= float(np.clip(best, 0.0, 1.0)) * moved
    white = np.where(even[:, None], left[1], left[0])
    by_row = 0.5 * np.sum(bench.white**2 - white**2, axis=1)
    return Ceiling(white, interval(Draws.of(counted, seed).sums(by_row)))


def _families(bench: Bench) -> Iterator[tuple[Matrix, Matrix]]:
    """Patterns (n, P) and courses (N, P) of every family, the likeliest first."""
    record = bench.record
    response, each = record.layout.response, np.eye(bench.orbit.shape[1])
    before, long_before = lagged(record, 1), lagged(record, 2)
    yield response, bench.currents - before
    yield response, before - long_before
    yield each, bench.orbit - _last(bench.orbit, record.starts)
    yield each, (bench.orbit - bench.orbit.mean(axis=0)) ** 2
    ramp = record.time / max(float(record.time[-1]), 1e-9)
    yield each, np.repeat(ramp[:, None], len(each), axis=1)


def _last(rows: Matrix, starts: Mask) -> Matrix:
    """Rows of the tick before; the first of a stretch stands for those before it."""
    before = rows.copy()
    before[1:] = rows[:-1]
    before[starts] = rows[starts]
    return before


def _masked(shapes: list[Matrix], filtered: list[Matrix], kept: Mask) -> Matrix:
    """Information of some rows on the coefficients of a family, shape (P, P)."""
    info = np.zeros((shapes[0].shape[1], shapes[0].shape[1]))
    for shape, course in zip(shapes, filtered, strict=True):
        rows = course[kept]
        info += (shape.T @ shape) * (rows.T @ rows)
    return info


def _coefficients(info: Matrix, score: Vector) -> Vector:
    """Best coefficients of a family, shape (P,)."""
    size = np.sqrt(np.maximum(np.diagonal(info), 1e-300))
    return _common_and_own(info / np.outer(size, size), score / size, size) / size


def _common_and_own(info: Matrix, score: Vector, size: Vector) -> Vector:
    """Coefficients, in units of their own information: one for all devices, then one for each."""
    together = size / np.sqrt(np.mean(size**2))
    known = float(together @ info @ together)
    pull = float(together @ score)
    common = 0.0
    if known > 1e-12 and 0.5 * pull**2 / known > np.log(np.sqrt(len(size)) + 1.0) + 2.0:
        common = pull / known
    score = score - info @ (together * common)
    eigen, axes = np.linalg.eigh(info)
    eigen = np.maximum(eigen, 0.0)
    turned = axes.T @ score
    best, width = 0.0, 0.0
    for trial in _WIDTHS**2:
        spread = 1.0 + trial * eigen
        evidence = 0.5 * float(np.sum(trial * turned**2 / spread - np.log(spread)))
        if evidence > best:
            best, width = evidence, float(trial)
    return together * common + axes @ (width * turned / (1.0 + width * eigen))
