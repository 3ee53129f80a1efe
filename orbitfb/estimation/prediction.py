"""Predict the orbit of the next row from the readings before it."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.transform import Matrix, StepTransform

_APART = 10
"""Rows between the first of a stretch and those that say where the orbit stood then. By hand: in so
many a filter has forgotten the noise of one reading, or hardly heeds it."""

_FAR = 5.0
"""Standard deviations from which a first reading is no chance: the orbit has moved since. By hand:
in ten thousand records one of 180 modes is as far by noise."""

_ANYWHERE = 1e12
"""Variance of an orbit of which nothing is known, in that of a reading [1]."""


def predicted(residual: Matrix, noise: StepNoise, transform: StepTransform) -> Matrix:
    """Predict what no model explains: E[x_n | readings before n], shape (N, n) [m].

    A walk of covariance Q read with noise N, in the modes of `StepNoise`, where every mode is a
    filter of its own (R. Kalman, J. Basic Eng. 82 (1960) 35). Where the orbit stood in the first
    row of a stretch is told by rows that come some time later: its own reading would bring its
    noise along, which is in the first step, too. So the first rows know a little of later ones. A
    short stretch begins with its first reading, and so does a mode that has moved since, as where a
    loop was just closed.

    Args:
        residual: Readings less what the model says, shape (N, n) [m].
        noise: Covariances of the walk and of the noise.
        transform: Stretches of the record.
    """
    seen = residual @ noise.modes
    found = np.empty_like(seen)
    for rows in transform.stretches:
        first, last = rows.start, rows.stop
        state, spread = seen[first], np.full_like(noise.ratio, _ANYWHERE)
        if last - first > 2 * _APART:
            for row in range(last - 1, first + _APART - 1, -1):
                state, spread = _updated(state, spread, seen[row], noise.ratio)
            spread = spread + (_APART - 1) * noise.ratio
            moved = (seen[first] - state) ** 2 > _FAR**2 * (spread + 1.0)
            state = np.where(moved, seen[first], state)
            spread = np.where(moved, _ANYWHERE, spread)
        for row in range(first, last):
            found[row] = state
            state, spread = _updated(state, spread, seen[row], noise.ratio)
    return found @ (noise.modes.T @ noise.white)


def _updated(state: Vector, spread: Vector, seen: Vector, ratio: Vector) -> tuple[Vector, Vector]:
    """State and its variance, in that of a reading, of the next row once a row is read, (n,)."""
    gain = spread / (spread + 1.0)
    return state + gain * (seen - state), gain + ratio
