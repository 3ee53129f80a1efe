"""Find the step of a rounded quantity from how it pulls at the likelihood.

The likelihood of a step q is a comb of needles: where the step is wrong by q²/u the multiples of
q pass a setpoint u by a whole step. A grid misses them all. But the error of rounding,
q · round(u/q) − u = (q/π) Σ_h (−1)^h/h · sin(2π h u/q), is a Fourier series in u, so that one
Fourier transform over u of the pull λ = ∂log L/∂θ has the score of every step at once.
"""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.actuating import usual_change
from orbitfb.effects.record import Record
from orbitfb.physics.optics import Matrix

_BINS = 1 << 20  # along u; finer steps than four bins are not looked for
_HARMONICS = 4
_APART = 6  # frequencies between two peaks


def common_steps(setpoints: Matrix, pull: Matrix, finest: float, count: int) -> list[float]:
    """Find steps that all columns may be rounded to.

    Args:
        setpoints: Shape (N, k) [A].
        pull: ∂log L/∂current, shape (N, k) [1/A].
        finest: Step below which nothing is looked for [A].
        count: How many to give.

    Returns:
        Steps, likeliest first [A].
    """
    found = _peaks(setpoints.ravel(), pull.ravel(), finest, count, absolute=True)
    return [_refined(setpoints, pull, *peak, 9) for peak in found]


def single_steps(setpoints: Matrix, pull: Matrix, finest: float, count: int) -> list[float]:
    """Find steps that single columns may be rounded to; as `common_steps`."""
    scored: list[tuple[float, float]] = []
    for setpoint, its in zip(setpoints.T, pull.T, strict=True):
        # a column moves over a small part of the range, so the phase is left open at first
        centre = 0.5 * float(np.max(setpoint) + np.min(setpoint))
        for frequency, width in _peaks(setpoint - centre, its, finest, 2, absolute=False):
            turns = 1 + 8 * int(min(200.0, np.ceil(width * np.max(np.abs(setpoint)))))
            step = _refined(setpoint, its, frequency, width, turns)
            scored.append((_significance(setpoint, its, step), step))
    return [step for _, step in sorted(scored, reverse=True)[:count]]


def read_back_steps(record: Record, count: int) -> list[float]:
    """Find steps of which all changes of a readback are multiples, commonest first [A]."""
    if record.readback is None:
        return []
    found: list[float] = []
    for column in record.readback.T:
        changes = np.abs(np.diff(column))
        changes = changes[np.isfinite(changes) & (changes > 1e-9 * np.max(np.abs(column)))]
        if len(changes) < 3:
            continue
        step = float(np.min(changes))
        turns = changes / step
        if step > 0.05 * usual_change(record) and np.all(np.abs(turns - np.round(turns)) < 0.01):
            # the mean over all changes is finer than the least of them
            found.append(float(np.sum(changes) / np.sum(np.round(turns))))
    distinct: list[float] = []
    for step in sorted(found, key=lambda s: -sum(abs(s - other) < 1e-3 * s for other in found)):
        if all(abs(step - other) > 1e-3 * step for other in distinct):
            distinct.append(step)
    return distinct[:count]


def _peaks(
    setpoint: Vector, pull: Vector, finest: float, count: int, *, absolute: bool
) -> list[tuple[float, float]]:
    """Frequencies 1/q [1/A] with the highest scores, and how wide a needle is there."""
    reach = float(np.max(np.abs(setpoint)))
    span = float(np.ptp(setpoint))
    if not span:
        return []
    width = max(finest / 4.0, 2.0 * reach / _BINS)
    bins = int(np.ceil(2.0 * reach / width)) + 2
    place = np.round(setpoint / width).astype(np.intp)
    course = np.bincount(np.mod(place, 2 * bins), weights=pull, minlength=2 * bins)
    transform = np.fft.rfft(course)
    spacing = 1.0 / (2 * bins * width)
    usable = len(transform) // 2
    if absolute:
        score = np.zeros(usable)
        for harmonic in range(1, _HARMONICS + 1):
            there = np.arange(0, min(usable * harmonic, len(transform)), harmonic)
            score[: len(there)] -= (-1.0) ** harmonic / harmonic * transform.imag[there]
    else:
        score = np.abs(transform[:usable])
    score[: min(usable, int(np.ceil(1.0 / (span * spacing))))] = 0.0  # coarser than the range
    peaks: list[tuple[float, float]] = []
    for _ in range(count):
        best = int(np.argmax(score))
        if score[best] <= 0:
            break
        peaks.append((best * spacing, spacing))
        score[max(0, best - _APART) : best + _APART + 1] = 0.0
    return peaks


def _refined(setpoints: Matrix, pull: Matrix, frequency: float, width: float, trials: int) -> float:
    steps = 1.0 / (frequency + width * np.linspace(-1.0, 1.0, trials))
    return max(map(float, steps), key=lambda step: _significance(setpoints, pull, step))


def _significance(setpoints: Matrix, pull: Matrix, step: float) -> float:
    """Score of a step per standard deviation, up to a constant."""
    error = np.round(setpoints / step) * step - setpoints
    return float(np.sum(pull * error) / (np.sqrt(np.sum(error**2)) or 1.0))
