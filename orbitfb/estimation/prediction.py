"""Predict the orbit of the next row from the readings before it."""

import numpy as np

from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.transform import Matrix, StepTransform


def predicted(residual: Matrix, noise: StepNoise, transform: StepTransform) -> Matrix:
    """Predict what no model explains: E[x_n | readings before n], shape (N, n) [m].

    A walk of covariance Q read with noise N, in the modes of `StepNoise`, where every mode is a
    filter of its own (R. Kalman, J. Basic Eng. 82 (1960) 35). The first row of a stretch is its own
    prediction.

    Args:
        residual: Readings less what the model says, shape (N, n) [m].
        noise: Covariances of the walk and of the noise.
        transform: Stretches of the record.
    """
    seen = residual @ noise.modes
    found = np.empty_like(seen)
    for rows in transform.stretches:
        state, spread = seen[rows.start].copy(), np.ones_like(noise.ratio)
        found[rows.start] = state
        for row in range(rows.start + 1, rows.stop):
            spread = spread + noise.ratio
            found[row] = state
            gain = spread / (spread + 1.0)
            state = state + gain * (seen[row] - state)
            spread = gain
    return found @ (noise.modes.T @ noise.white)
