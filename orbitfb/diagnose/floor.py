"""Estimate the noise floor of a record: one reading noise, a random walk per mode.

Reading noise is white over the BPMs, so every mode has the same r² of it; the ground moves
magnets, so every mode has its own q. How the magnets move (alone, in girders, with a memory) is a
nuisance: it only sets the q of the modes, which are estimated with the record.
"""

import numpy as np
from scipy.signal import lfilter

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.effects.layout import Layout
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

_LADDER = 1.0 / (1.0 + np.exp(-np.linspace(-5.5, 4.0, 20)))
"""Kalman gains that a mode is tried with, even in log L / (1 − L)."""
_PASSES = 30


def noise_modes(layout: Layout) -> Matrix:
    """Modes in which ground motion and reading noise are both (nearly) uncorrelated.

    Those of the orbits that quadrupoles make, each moving alone; without a ring those of the
    response.

    Returns:
        Orthonormal columns, shape (n, n).
    """
    if layout.ring is None or not len(layout.ring.places("QUAD")):
        covariance = layout.response @ layout.response.T
    else:
        strength = layout.ring.strength("QUAD")
        moved = [layout.orbit_per_kick("QUAD", plane) * strength for plane in layout.planes]
        covariance = np.sum([orbit @ orbit.T for orbit in moved], axis=0)
    return np.linalg.eigh(covariance)[1][:, ::-1]


def estimate_floor(left: Matrix, starts: Mask, modes: Matrix) -> NoiseFloor:
    """Fit r² and every mode's q by maximum likelihood.

    Args:
        left: What the model leaves, rows of the BPMs' space, shape (N, n) [m].
        starts: Where stretches begin, shape (N,).
        modes: Orthonormal columns, shape (n, n).
    """
    z = left @ modes
    steps = np.zeros_like(z)
    steps[1:] = z[1:] - z[:-1]
    steps[starts] = 0.0
    squares = np.array([_mean_square(steps, starts, gain) for gain in _LADDER])
    reading = float(np.median(squares[0])) / 2
    level = np.zeros(z.shape[1], dtype=np.intp)
    for _ in range(_PASSES):
        variance = reading / (1.0 - _LADDER)[:, None]
        cost = np.log(variance) + squares / variance
        level = np.argmin(cost, axis=0)
        own = squares[level, np.arange(len(level))]
        before, reading = reading, float(np.mean(own * (1.0 - _LADDER[level])))
        if abs(reading / before - 1.0) < 1e-5:
            break
    refined = _refined(squares, reading, level)
    return NoiseFloor(modes, reading, reading * refined**2 / (1.0 - refined))


def _mean_square(steps: Matrix, starts: Mask, gain: float) -> Vector:
    """Mean squared innovation of every mode under a steady gain, the beginnings left out."""
    begins = np.flatnonzero(starts)
    total, rows = np.zeros(steps.shape[1]), 0
    for begin, end in zip(begins, [*begins[1:], len(starts)], strict=True):
        skipped = min(int(3.0 / gain) + 1, (end - begin) // 2 + 1)
        filtered = np.asarray(lfilter([1.0], [1.0, gain - 1.0], steps[begin:end], axis=0))
        piece = filtered[skipped:]
        total += np.sum(piece**2, axis=0)
        rows += len(piece)
    return total / max(rows, 1)


def _refined(squares: Matrix, reading: float, level: Indices) -> Vector:
    """Move from the step of the ladder to the minimum of the parabola through its neighbours."""
    variance = reading / (1.0 - _LADDER)[:, None]
    cost = np.log(variance) + squares / variance
    level = np.clip(level, 1, len(_LADDER) - 2)
    mode = np.arange(len(level))
    place = np.log(_LADDER / (1.0 - _LADDER))
    x0, x1, x2 = place[level - 1], place[level], place[level + 1]
    y0, y1, y2 = cost[level - 1, mode], cost[level, mode], cost[level + 1, mode]
    first, second = (y1 - y0) / (x1 - x0), (y2 - y1) / (x2 - x1)
    bend = (second - first) / (x2 - x0)
    best = np.where(bend > 0, 0.5 * (x0 + x1) - 0.5 * first / np.where(bend > 0, bend, 1.0), x1)
    best = np.clip(best, x0, x2)
    return 1.0 / (1.0 + np.exp(-best))
