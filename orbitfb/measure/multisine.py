"""Many correctors at once, each at a frequency of its own: the waveform, and what it showed.

In a pass of T ticks corrector j moves as A_j sin(2π k_j i / T + φ_j) with a bin k_j that no other
has and a random phase, so that the peak of the sum stays low. An orbit that was read under sample i
is fitted, all correctors together, by

    orbit = c + d i + e i² + Σ_j (a_j sin θ_j + b_j cos θ_j),   a + i b = r_j exp(−i (ω_j τ + ψ_j)),

by least squares, so that orbits may be missing and a slow drift stays out. The delay τ is one for
all correctors; what is left of the phase, ψ_j, is the lag of a corrector.

Source: Schoukens, Pintelon and Rolain, Mastering System Identification in 100 Exercises, ch. 2;
for light sources e.g. Safranek et al., fast response matrices with AC excitation.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.errors import ConfigError, MeasurementError
from orbitfb.core.signals import Mask, Vector

LONGEST_DELAY = 6.0
"""Delay of an orbit behind the setpoints that is looked for [ticks]."""
_OUTLIER = 6.0
_MOST_OUTLIERS = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Multisine:
    """A periodic waveform.

    Args:
        ticks: T, its length.
        bins: Periods of every corrector within it, shape (m,).
        phases: φ, shape (m,) [rad].
    """

    ticks: int
    bins: Vector
    phases: Vector

    def angles(self, samples: Vector) -> Vector:
        """Give θ of all correctors at samples (K,): shape (K, m) [rad]."""
        return 2.0 * np.pi * np.outer(samples, self.bins) / self.ticks + self.phases

    def levels(self, samples: Vector) -> Vector:
        """Give the levels at samples (K,), from −1 to 1: shape (K, m)."""
        return np.sin(self.angles(samples))


def design(correctors: int, least: int, lowest: float, highest: float, seed: int) -> Multisine:
    """Give every corrector a frequency.

    Args:
        correctors: m.
        least: Least length [ticks].
        lowest: Lowest frequency [1/tick].
        highest: Highest frequency [1/tick].
        seed: Of the phases, and of who gets which frequency.

    Raises:
        ConfigError: There is no room between the lowest and the highest.
    """
    if not lowest < highest:
        raise ConfigError(
            f"measure.lowest {lowest:g} is not below measure.highest {highest:g} [1/tick]"
        )
    ticks = max(least, int(np.ceil((correctors + 1) / (highest - lowest))))
    first, last = int(np.ceil(lowest * ticks)), int(np.floor(highest * ticks))
    rng = np.random.default_rng(seed)
    bins = np.linspace(first, last, correctors).round() if correctors > 1 else np.array([first])
    return Multisine(ticks, rng.permutation(bins), rng.uniform(0.0, 2.0 * np.pi, correctors))


@dataclass(frozen=True, slots=True, eq=False)
class Demodulated:
    """What the orbits showed, per level 1.

    Args:
        response: r, shape (n, m) [m]; NaN at a BPM that was hardly ever valid.
        sigma: Its standard deviation, shape (n, m) [m].
        phase: ψ, shape (m,) [rad].
        delay: τ [ticks].
        noise: What the fit leaves over, rms [m].
    """

    response: Vector
    sigma: Vector
    phase: Vector
    delay: float
    noise: float


def demodulate(wave: Multisine, samples: Vector, orbit: Vector) -> Demodulated:
    """Find the response of every corrector.

    Args:
        wave: The waveform.
        samples: Sample in force at every orbit, shape (K,).
        orbit: Shape (K, n) [m]; NaN where a BPM was not valid.

    Raises:
        MeasurementError: Too few orbits, or too many that the waveform does not explain.
    """
    angles = wave.angles(samples)
    slow = np.vander((samples - samples.mean()) / wave.ticks, 3)
    basis = np.concatenate([np.sin(angles), np.cos(angles), slow], axis=1)
    used = np.isfinite(orbit).mean(axis=1) > 0.5
    used &= ~_outliers(basis, orbit, used)
    valid = np.isfinite(orbit[used]).all(axis=0)
    m, n = len(wave.bins), orbit.shape[1]
    solution, left, share = _solve(basis[used], orbit[used][:, valid])
    freedom = used.sum() - basis.shape[1]
    variance = np.sum(left**2, axis=0) / freedom
    waves = solution[:m] + 1j * solution[m : 2 * m]
    delay = _delay(waves, wave)
    waves = waves * np.exp(2j * np.pi * wave.bins / wave.ticks * delay)[:, None]
    phase = -0.5 * np.angle(np.sum(waves**2, axis=1))
    response, sigma = np.full((n, m), np.nan), np.full((n, m), np.nan)
    response[valid] = (waves * np.exp(1j * phase)[:, None]).real.T
    sigma[valid] = np.sqrt(np.outer(variance, share[:m]))
    return Demodulated(response, sigma, phase, delay, float(np.sqrt(variance.mean())))


def _solve(basis: Vector, orbit: Vector) -> tuple[Vector, Vector, Vector]:
    rows, columns = basis.shape
    if rows < 1.1 * columns or not orbit.shape[1]:
        raise MeasurementError(
            f"{rows} orbits with {orbit.shape[1]} BPMs valid throughout cannot tell {columns} "
            "numbers per BPM; mask the BPMs that come and go, make measure.ticks larger, or "
            "measure one by one"
        )
    solution: Vector = np.linalg.lstsq(basis, orbit, rcond=None)[0].astype(np.float64)
    share: Vector = np.diag(np.linalg.inv(basis.T @ basis)).astype(np.float64)
    return solution, orbit - basis @ solution, share


def _outliers(basis: Vector, orbit: Vector, used: Mask) -> Mask:
    """Find orbits that were read under other setpoints than they should have been."""
    valid = np.isfinite(orbit[used]).all(axis=0)
    _, left, _ = _solve(basis[used], orbit[used][:, valid])
    size = np.sqrt(np.mean(left**2, axis=1))
    found = np.zeros(len(orbit), dtype=np.bool_)
    found[used] = size > _OUTLIER * np.median(size)
    if found.sum() > _MOST_OUTLIERS * used.sum():
        raise MeasurementError(
            f"{found.sum()} of {used.sum()} orbits do not follow the waveform: they do not come "
            "in step with the writes; measure one by one (measure.at_once = 1)"
        )
    return found


def _delay(waves: NDArray[np.complex128], wave: Multisine) -> float:
    """Find the delay that leaves the least out of phase [ticks]."""
    steps = np.linspace(-0.5, LONGEST_DELAY, 1301)
    squares = np.sum(waves**2, axis=1)  # of r² exp(−2 i ω τ): what it is in phase with itself
    turned = np.exp(4j * np.pi * np.outer(steps, wave.bins) / wave.ticks) @ squares
    return float(steps[int(np.argmax(turned.real))])
