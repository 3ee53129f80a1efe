"""Lines in what is left: a course that comes again and again, which no law of the library knows.

An ordinate of the periodogram of white noise over the mean of K others has the distribution
F(2, 2 K), a sum over n channels F(2 n, 2 n K) (P. J. Brockwell and R. A. Davis, Time Series:
Theory and Methods, ch. 10). The others are its neighbours, so that a spectrum that is smooth, but
not flat, has no lines.
"""

import numpy as np
from scipy import stats

from orbitfb.core.signals import Vector
from orbitfb.diagnose.answer_blocks import GoodnessTest
from orbitfb.physics.optics import Matrix

TOLERANCE = 0.05
"""Share of a level by which even neighbours may differ, from a floor that is not quite right."""
_NEIGHBOURS = 40
"""On either side."""
_SLOWEST = 8
"""Cycles per record below which a line is a drift."""


def line_tests(channels: Matrix, names: tuple[str, ...], rate: float) -> tuple[GoodnessTest, ...]:
    """Look for lines of all BPMs together, of one BPM, and in how much all of them scatter.

    Args:
        channels: What is left of the BPMs' readings, white and of unit variance, shape (N, n).
        names: Of the BPMs.
        rate: How often a test may have a flag by chance.

    Returns:
        None where the record is too short for neighbours.
    """
    power = _power(channels / np.sqrt(np.mean(channels**2, axis=0)))
    if len(power) < _SLOWEST + 2 * _NEIGHBOURS + 1:
        return ()
    count = channels.shape[1]
    alone = _over_neighbours(power)
    every = _over_neighbours(power.sum(axis=1))
    scatter = np.sum(channels**2, axis=1)
    rhythm = _over_neighbours(_power(scatter - scatter.mean()))
    row, worst = np.unravel_index(int(np.argmax(alone)), alone.shape)
    own = _judged("line of a BPM", alone.ravel(), 1, rate, f"{names[worst]}, ", int(row), channels)
    together = _judged("line of all BPMs", every, count, rate, "", int(np.argmax(every)), channels)
    beat = _judged("rhythm of the scatter", rhythm, 1, rate, "", int(np.argmax(rhythm)), channels)
    return together, own, beat


def _power(courses: Matrix | Vector) -> Matrix:
    """Ordinates of the periodogram, but those of the slowest, shape (F, …)."""
    transformed = np.fft.rfft(courses, axis=0)[1 : (len(courses) + 1) // 2]
    return np.abs(transformed[_SLOWEST - 1 :]) ** 2 / len(courses)


def _over_neighbours(power: Matrix | Vector) -> Matrix:
    """Every ordinate over the mean of its neighbours."""
    total = np.concatenate([np.zeros_like(power[:1]), np.cumsum(power, axis=0)])
    first = np.clip(np.arange(len(power)) - _NEIGHBOURS, 0, len(power) - 2 * _NEIGHBOURS - 1)
    others = total[first + 2 * _NEIGHBOURS + 1] - total[first] - power
    return power / np.maximum(others / (2 * _NEIGHBOURS), 1e-300)


def _judged(
    name: str, ratios: Vector, count: int, rate: float, what: str, row: int, channels: Matrix
) -> GoodnessTest:
    """Judge the largest of some ordinates, each a sum over so many channels."""
    value = float(np.max(ratios))
    share = rate / len(ratios)
    chance = float(stats.f.isf(share, 2 * count, 4 * count * _NEIGHBOURS))
    limit = chance * (1.0 + TOLERANCE)
    period = len(channels) / (row + _SLOWEST)
    return GoodnessTest(
        name=name,
        value=value,
        limit=limit,
        flagged=not value <= limit,
        note=f"power over that of neighbouring frequencies, {what}every {period:.3g} ticks",
        nats=count * (value - 1.0),
    )
