"""Errors of predictions some rows ahead, and the part that noise and walk alone leave of them.

Where the ground is no walk (`StepNoise.colour`) the innovations of a walk are filtered once more,
by the causal factor of what the spectrum of the steps is beyond that of a walk (A. Kolmogorov,
Bull. Acad. Sci. USSR Math. 5 (1941) 3; through the cepstrum as in A. Oppenheim, R. Schafer,
Discrete-Time Signal Processing, 2010, section 13.5).
"""

import numpy as np
from scipy.signal import oaconvolve

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.row_sums import moving_root
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.priors import OCTAVES
from orbitfb.estimation.transform import Matrix, StepTransform

_LAGS = 2**OCTAVES
"""Rows over which the ground is remembered: so many frequencies part its slowest octave from zero
and from the next."""


def whitened(spectrum: Matrix, noise: StepNoise, transform: StepTransform) -> Matrix:
    """Innovations of every mode, of variance one where the floor is right, shape (T, n).

    The steps of a walk's mode have covariance q + 2 at lag 0 and −1 at lag 1, so that an innovation
    is e_t = Δ_t + e_(t−1)/v_(t−1) with variance v_t = q + 2 − 1/v_(t−1), exactly from the first
    step of a stretch on (P. Brockwell, R. Davis, Time Series, 1991, section 5.2).

    Args:
        spectrum: Transformed steps, shape (T, n) [m].
        noise: Covariances of walk and noise.
        transform: Of the record.
    """
    steps = transform.turn(spectrum) @ noise.modes
    found = np.empty_like(steps)
    usual = noise.ratio + 2.0
    coloured = bool(np.any(noise.colour))
    factor = _causal(-_cepstrum(noise)) if coloured else np.ones((1, len(usual)))
    for part in transform.pieces:
        error, variance = np.zeros_like(usual), np.full_like(usual, np.inf)
        for row in range(part.start, part.stop):
            error = steps[row] + error / variance
            variance = usual - 1.0 / variance
            found[row] = error / np.sqrt(variance)
        if coloured:
            length = part.stop - part.start
            found[part] = oaconvolve(found[part], factor[:length], axes=0)[:length]
    return found


def _cepstrum(noise: StepNoise) -> Matrix:
    """Cepstrum of the spectrum of every mode's steps over that of a walk, shape (_LAGS, n)."""
    eigenvalue = 2.0 - 2.0 * np.cos(np.pi * np.arange(_LAGS + 1) / _LAGS)
    eigenvalue[0] = eigenvalue[1] / 4.0
    walk = noise.ratio + eigenvalue[:, None]
    beyond = np.log(np.maximum(noise.variance_at(eigenvalue) / walk, 1e-300))
    return np.asarray(np.fft.irfft(beyond, axis=0)[:_LAGS])


def _causal(cepstrum: Matrix, count: int = _LAGS) -> Matrix:
    """Causal filter whose squared gain has a cepstrum, shape (count, n)."""
    folded = np.zeros((2 * _LAGS, cepstrum.shape[1]))
    folded[:_LAGS] = cepstrum
    folded[0] /= 2.0
    found = np.fft.irfft(np.exp(np.fft.rfft(folded, axis=0)), axis=0)
    return np.asarray(found[:count])


def _spread(noise: StepNoise) -> Vector:
    """Variance of the error one row ahead of every mode, shape (n,)."""
    walk = 1.0 / moving_root(noise.ratio)
    return walk * np.exp(_cepstrum(noise)[0]) if np.any(noise.colour) else walk


def _kept(noise: StepNoise, ahead: int) -> Matrix:
    """How much of an innovation is in the orbit so many rows later, shape (ahead, n).

    In a walk all but the share r of the noise stays.
    """
    answer = np.ones((1, len(noise.ratio)))
    if np.any(noise.colour):
        answer = _causal(_cepstrum(noise), ahead)
        answer = answer / answer[0]
    steps = np.zeros((ahead, len(noise.ratio)))
    steps[: len(answer)] = answer
    steps[1:] -= moving_root(noise.ratio) * steps[:-1].copy()
    return np.cumsum(steps, axis=0)


def at_bpms(white: Matrix, noise: StepNoise) -> Matrix:
    """Errors of the prediction one row ahead at the BPMs, shape (T, n) [m], from whitened ones."""
    return (white * np.sqrt(_spread(noise))) @ (noise.white @ noise.modes).T


def floor_of(noise: StepNoise, ahead: int = 1) -> Vector:
    """Mean square that noise and walk leave of a prediction some rows ahead, shape (n,) [m²].

    Args:
        noise: Covariances of walk and noise.
        ahead: Rows.
    """
    back = (noise.white @ noise.modes) ** 2
    return back @ (_spread(noise) * np.sum(_kept(noise, ahead) ** 2, axis=0))


def independent(noise: StepNoise) -> float:
    """How many independent readings the errors of a row are worth: (tr C)² / tr C².

    Args:
        noise: Covariances of walk and noise.
    """
    back = (noise.white @ noise.modes) * np.sqrt(_spread(noise))
    covariance = back @ back.T
    return float(np.trace(covariance) ** 2 / np.sum(covariance**2))


def errors_ahead(white: Matrix, noise: StepNoise, transform: StepTransform, ahead: int) -> Matrix:
    """Errors of a prediction some rows ahead, shape (T', n) [m].

    What an orbit is beyond its prediction is what is left of the innovations since.

    Args:
        white: Whitened innovations, shape (T, n).
        noise: Covariances of walk and noise.
        transform: Of the record.
        ahead: Rows k.
    """
    kept = _kept(noise, ahead)
    found = [np.zeros((0, white.shape[1]))]
    for part in transform.pieces:
        length = part.stop - part.start
        if length >= ahead:
            found.append(oaconvolve(white[part], kept, axes=0)[ahead - 1 : length])
    return at_bpms(np.vstack(found), noise)
