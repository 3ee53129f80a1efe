"""Errors of predictions some rows ahead, and the part that noise and walk alone leave of them."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.row_sums import moving_root
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.transform import Matrix, StepTransform


def whitened(spectrum: Matrix, noise: StepNoise, transform: StepTransform) -> Matrix:
    """Innovations of every mode, of variance one where the floor is right, shape (T, n).

    The steps of a mode have covariance q + 2 at lag 0 and −1 at lag 1, so that an innovation is
    e_t = Δ_t + e_(t−1)/v_(t−1) with variance v_t = q + 2 − 1/v_(t−1), exactly from the first step
    of a stretch on (P. Brockwell, R. Davis, Time Series, 1991, section 5.2).

    Args:
        spectrum: Transformed steps, shape (T, n) [m].
        noise: Covariances of walk and noise.
        transform: Of the record.
    """
    steps = transform.turn(spectrum) @ noise.modes
    found = np.empty_like(steps)
    usual = noise.ratio + 2.0
    for part in transform.pieces:
        error, variance = np.zeros_like(usual), np.full_like(usual, np.inf)
        for row in range(part.start, part.stop):
            error = steps[row] + error / variance
            variance = usual - 1.0 / variance
            found[row] = error / np.sqrt(variance)
    return found


def at_bpms(white: Matrix, noise: StepNoise) -> Matrix:
    """Errors of the prediction one row ahead at the BPMs, shape (T, n) [m], from whitened ones."""
    return (white / np.sqrt(moving_root(noise.ratio))) @ (noise.white @ noise.modes).T


def floor_of(noise: StepNoise, ahead: int = 1) -> Vector:
    """Mean square that noise and walk leave of a prediction some rows ahead, shape (n,) [m²].

    In a mode the error of one row ahead has variance 1/r, and every further row adds a step q of
    the walk.

    Args:
        noise: Covariances of walk and noise.
        ahead: Rows.
    """
    back = (noise.white @ noise.modes) ** 2
    return back @ (1.0 / moving_root(noise.ratio) + (ahead - 1) * noise.ratio)


def independent(noise: StepNoise) -> float:
    """How many independent readings the errors of a row are worth: (tr C)² / tr C².

    Args:
        noise: Covariances of walk and noise.
    """
    back = (noise.white @ noise.modes) / np.sqrt(moving_root(noise.ratio))
    covariance = back @ back.T
    return float(np.trace(covariance) ** 2 / np.sum(covariance**2))


def errors_ahead(spectrum: Matrix, errors: Matrix, transform: StepTransform, ahead: int) -> Matrix:
    """Errors of a prediction some rows ahead, shape (T', n) [m].

    The state after row n − k is what was read at n − k + 1 less its error, so that the error at
    row n is that of row n − k + 1 and all steps since.

    Args:
        spectrum: Transformed steps of what is predicted, shape (T, n) [m].
        errors: Of the prediction one row ahead, shape (T, n) [m].
        transform: Of the record.
        ahead: Rows k.
    """
    if ahead == 1:
        return errors
    steps = transform.turn(spectrum)
    found = [np.zeros((0, steps.shape[1]))]
    for part in transform.pieces:
        length = part.stop - part.start
        if length >= ahead:
            run = np.vstack([np.zeros((1, steps.shape[1])), np.cumsum(steps[part], axis=0)])
            since = run[ahead:] - run[1 : length - ahead + 2]
            found.append(errors[part.start : part.stop - ahead + 1] + since)
    return np.vstack(found)
