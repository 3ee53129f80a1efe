"""Estimate the noise floor of a record: a reading noise, a random walk per mode.

Reading noise, over that of its BPM, is white over the BPMs, so every mode has the same r² of it;
the ground moves magnets, so every mode has its own q. How the magnets move (alone, in girders) is
a nuisance: it only sets the q of the modes, which are estimated with the record. That they go on as
they went is another one (`drift_memory`).
"""

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.diagnose.noise_modes import NoiseModes
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

LADDER = np.exp(np.linspace(-13.0, 10.0, 39))
"""Ratios q / r² that a mode is tried with."""
_PASSES = 30
_NEIGHBOURS = 4.0
"""Modes over which the evidence of neighbours fades to 1/e."""
_SHARED = 0.3
"""Weight of the next neighbour's evidence."""
_MOST_SHARED = 3.0
"""Most that a neighbour can say against a level [nats]."""


def estimate_floor(left: Matrix, starts: Mask, modes: NoiseModes) -> NoiseFloor:
    """Fit r² and every mode's q by maximum likelihood.

    What moves magnets moves the orbit in modes of like size alike, so a mode also learns from its
    neighbours: the walk of a weak mode is far too slow to be seen in one record of it alone.

    Args:
        left: What the model leaves, rows of the BPMs' space, shape (N, n) [m].
        starts: Where stretches begin, shape (N,).
        modes: In which noise and drift are uncorrelated.
    """
    squares, logs, rows = evidence(left @ modes.directions, starts)
    reading = float(np.quantile(squares[0], 0.25)) / max(rows, 1)  # modes that hardly walk
    level = np.zeros(squares.shape[1], dtype=np.intp)
    cost = squares
    for _ in range(_PASSES):
        cost = _with_neighbours(logs[:, None] + squares / reading)
        level = np.argmin(cost, axis=0)
        before, reading = (
            reading,
            float(np.mean(squares[level, np.arange(len(level))])) / max(rows, 1),
        )
        if abs(reading / before - 1.0) < 1e-5:
            break
    return NoiseFloor(modes, reading, reading * _between(cost, level))


def evidence(z: Matrix, starts: Mask) -> tuple[Matrix, Vector, int]:
    """Sum the likelihood of every ratio of the ladder, the beginnings of stretches exact.

    Returns:
        Σ e² / (S / r²) of every ratio and mode, (G, n) [m²]; Σ log S / r² of every ratio, (G,);
        and the rows that count.
    """
    squares = np.zeros((len(LADDER), z.shape[1]))
    logs, rows = np.zeros(len(LADDER)), 0
    for begin, end in _ends(starts):
        filtered = np.ones(len(LADDER))
        feedback = np.zeros(len(LADDER))
        innovation = np.zeros_like(squares)
        steps = np.diff(z[begin:end], axis=0)
        for step in steps:
            innovation *= feedback[:, None]
            innovation += step
            predicted = filtered + LADDER
            variance = predicted + 1.0
            filtered = predicted / variance
            feedback = 1.0 - filtered
            squares += innovation**2 / variance[:, None]
            logs += np.log(variance)
        rows += len(steps)
    return squares, logs, rows


def _ends(starts: Mask) -> list[tuple[int, int]]:
    begins = [int(begin) for begin in np.flatnonzero(starts)]
    return list(zip(begins, [*begins[1:], len(starts)], strict=True))


def _with_neighbours(cost: Matrix) -> Matrix:
    """Add the evidence of neighbouring modes, fading with their distance, and with its limit.

    A mode that the record shows well has its own level, whatever its neighbours have.
    """
    index = np.arange(cost.shape[1])
    distance = np.abs(np.subtract.outer(index, index))
    weights = np.where(distance == 0, 0.0, _SHARED * np.exp(-(distance - 1.0) / _NEIGHBOURS))
    return cost + np.minimum(cost - cost.min(axis=0), _MOST_SHARED) @ weights


def _between(cost: Matrix, level: Indices) -> Vector:
    """Ratio q / r² at the minimum of the parabola through the best step and its neighbours."""
    level = np.clip(level, 1, len(LADDER) - 2)
    mode = np.arange(len(level))
    place = np.log(LADDER)
    below, here, above = (cost[level + step, mode] for step in (-1, 0, 1))
    bend = below - 2.0 * here + above
    shift = np.where(bend > 0, 0.5 * (below - above) / np.where(bend > 0, bend, 1.0), 0.0)
    return np.exp(place[level] + np.clip(shift, -1.0, 1.0) * (place[1] - place[0]))
