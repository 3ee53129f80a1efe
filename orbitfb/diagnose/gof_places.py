"""Whether what is left at single places goes by jumps, or with the size of what correctors did."""

import numpy as np
from scipy import stats

from orbitfb.diagnose.answer_blocks import GoodnessTest
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.gap_maps import lagged
from orbitfb.diagnose.ladder import Ladder
from orbitfb.diagnose.result.naming import column_names
from orbitfb.effects.kicks import source_names, source_patterns
from orbitfb.physics.optics import Matrix

JUMPS = "kurtosis by source of kicks"
SIZES = "correlation with the size of a corrector's change"
_TOLERATED = 0.05
"""Share by which limits are wider, for a floor whose level is not quite right."""
_LAGS = 2
_SEEN = 1e-9
"""Information below which nothing is seen of a course."""


def place_tests(bench: Bench, white: Matrix, rate: float) -> tuple[GoodnessTest, ...]:
    """Test what is left at every place that may kick, and at every corrector.

    Args:
        bench: The record under the causes that were found.
        white: Its innovations but those of first rows, shape (K, n).
        rate: How often a test may have a flag by chance.
    """
    return _jumps(bench, white, rate), _sizes(bench, rate)


def _jumps(bench: Bench, white: Matrix, rate: float) -> GoodnessTest:
    """Kurtosis of what is left along the orbit of every place (F. J. Anscombe, W. J. Glynn, 1983).

    Ground that moves is normal at every place; what kicks now and then is not.
    """
    layout = bench.record.layout
    seen = bench.floor.seen(source_patterns(layout))
    size = np.linalg.norm(seen, axis=0)
    able = np.flatnonzero(size > 0.0)
    values = stats.kurtosistest(white @ (seen[:, able] / size[able]), axis=0).statistic
    worst = int(np.argmax(np.abs(values)))
    note = f"standard deviations, {source_names(layout)[able[worst]]}"
    return _judged(JUMPS, float(values[worst]), rate, len(values), note)


def _sizes(bench: Bench, rate: float) -> GoodnessTest:
    """Correlation of what is left at every corrector with how far every one went, now or before."""
    record, floor = bench.record, bench.floor
    response, names = record.layout.response, column_names(record.layout.correctors)
    pull = floor.adjoint(bench.white, record.starts) @ response
    ladder = Ladder(floor)
    shapes = [np.sum(shape**2, axis=0) for shape in ladder.shapes(response)]
    found: list[Matrix] = []
    for lag in range(_LAGS):
        course = np.abs(lagged(record, lag) - lagged(record, lag + 1))
        course -= course.mean(axis=0)
        left = ladder.filtered(course, record.starts)
        known = sum(
            np.outer(shape, np.sum(own**2, axis=0)) for shape, own in zip(shapes, left, strict=True)
        )
        found.append(pull.T @ course / np.sqrt(np.where(known > _SEEN, known, np.inf)))
    values = np.array(found)
    lag, worst, other = np.unravel_index(int(np.argmax(np.abs(values))), values.shape)
    note = f"standard deviations, lag {lag + 1}, {names[worst]} with {names[other]}"
    return _judged(SIZES, float(values[lag, worst, other]), rate, values.size, note)


def _judged(name: str, value: float, rate: float, count: int, note: str) -> GoodnessTest:
    """Hold the largest of so many normal numbers against what chance exceeds at a rate."""
    limit = float(stats.norm.isf(rate / (2 * count))) * (1.0 + _TOLERATED)
    flagged, nats = not abs(value) <= limit, 0.5 * value**2
    return GoodnessTest(name=name, value=value, limit=limit, flagged=flagged, note=note, nats=nats)
