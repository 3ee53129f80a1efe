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

LADDER = np.exp(np.linspace(-13.0, 10.0, 115))
"""Ratios q / r² that a mode is tried with."""
_DECADES = 4.0
"""How far below the steps of the orbit its reading noise is looked for."""
_STEP = 0.1
"""Step of the logarithm of the reading noise."""
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
    reading = _reading(squares, logs, max(rows, 1))
    cost = _with_neighbours(logs[:, None] + squares / reading)
    return NoiseFloor(modes, reading, reading * _lowest(cost)[0])


def _reading(squares: Matrix, logs: Vector, rows: int) -> float:
    """Variance of reading noise at the top of the likelihood, every mode at its own best level.

    A search along the profile: where every mode walks far beyond the noise, estimating the noise
    and the levels in turn moves by less than a step of the ladder, and stops anywhere.
    """
    steps = np.quantile(squares[-1], 0.25) * LADDER[-1] / rows  # of variance 2 r² + q
    tried = np.log(steps) + np.arange(-_DECADES * np.log(10.0), 1.0, _STEP)
    profile = np.array(
        [
            rows * squares.shape[1] * place
            + np.sum(_lowest(logs[:, None] + squares * np.exp(-place))[1])
            for place in tried
        ]
    )
    best = _lowest(profile[:, None], tried)[0]
    return float(best[0])


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


def _lowest(cost: Matrix, places: Vector | None = None) -> tuple[Vector, Vector]:
    """Where every column is lowest, and how low, by the parabola through the best and its two.

    Args:
        cost: A column per mode, shape (G, n).
        places: Equidistant logarithms of what the rows were tried with; of the ladder if None.

    Returns:
        What the parabola is lowest at, shape (n,), and its cost there, shape (n,).
    """
    places = np.log(LADDER) if places is None else places
    level = np.clip(np.argmin(cost, axis=0), 1, len(places) - 2)
    column = np.arange(cost.shape[1])
    below, here, above = (cost[level + step, column] for step in (-1, 0, 1))
    bend = below - 2.0 * here + above
    slope = 0.5 * (above - below)
    shift = np.where(bend > 0, -slope / np.where(bend > 0, bend, 1.0), 0.0)
    shift = np.clip(shift, -1.0, 1.0)
    lowest = here + slope * shift + 0.5 * bend * shift**2
    return np.exp(places[level] + shift * (places[1] - places[0])), lowest
