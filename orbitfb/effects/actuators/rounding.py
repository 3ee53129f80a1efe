"""Find the step of a rounded quantity from how it pulls at the likelihood.

The likelihood of a step q is a comb of needles: where the step is wrong by q²/u the multiples of
q pass a setpoint u by a whole step. A grid misses them all. But the error of rounding,
q · round(u/q) − u = (q/π) Σ_h (−1)^h/h · sin(2π h u/q), is a Fourier series in u, so that one
Fourier transform over u of the pull λ = ∂log L/∂θ has the score of every step at once. Peaks that
are no higher than the highest of so many lines of noise are not looked at.
"""

from collections.abc import Sequence
from typing import cast

import numpy as np
from scipy.fft import next_fast_len
from scipy.interpolate import CubicSpline

from orbitfb.core.robust import TO_SIGMA
from orbitfb.core.signals import Vector
from orbitfb.effects.actuating import usual_change
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.record import Record

_BINS = 1 << 20  # along u; finer steps than four bins are not looked for
_HARMONICS = 4
_APART = 6  # frequencies between two peaks
_CLOSER = 12  # peaks of single columns that are looked at closely
_TRIED = 30  # frequencies of one column that are tried at the tip of their needle
_NODES = 17  # between which the transform of one column is smooth


def common_steps(
    setpoints: Matrix, pull: Matrix, finest: float, count: int, groups: Sequence[Indices] = ()
) -> list[float]:
    """Find steps that all columns may be rounded to, or those of a group.

    Args:
        setpoints: Shape (N, k) [A].
        pull: ∂log L/∂current, shape (N, k) [1/A].
        finest: Step below which nothing is looked for [A].
        count: How many to give.
        groups: Columns of each; all columns are one group where there are none.

    Returns:
        Steps, likeliest first [A].
    """
    every = groups or [np.arange(setpoints.shape[1])]
    found: list[tuple[float, int, float, float]] = []
    for index, own in enumerate(every):
        peaks = _peaks(
            setpoints[:, own].ravel(), pull[:, own].ravel(), finest, count,
            absolute=True, others=len(every),
        )  # fmt: skip
        found += [(height, index, frequency, width) for height, frequency, width in peaks]
    scored: list[tuple[float, int, float]] = []
    for _, index, frequency, width in sorted(found, reverse=True)[:count]:
        one, its = setpoints[:, every[index]], pull[:, every[index]]
        step = _best(one, its, 1.0 / (frequency + width * np.linspace(-1.0, 1.0, 9)))
        scored.append((_significance(one, its, step), index, step))
    highest = max(scored, default=(0.0, 0, 0.0))[0]
    return [
        _polished(setpoints[:, every[index]], pull[:, every[index]], step)
        if height > 0.5 * highest
        else step
        for height, index, step in scored
    ]


def single_steps(setpoints: Matrix, pull: Matrix, finest: float, count: int) -> list[float]:
    """Find steps that single columns may be rounded to; as `common_steps`."""
    found: list[tuple[float, int, float, float]] = []
    for column, (setpoint, its) in enumerate(zip(setpoints.T, pull.T, strict=True)):
        # a column moves over a small part of the range, so the phase is left open at first
        peaks = _peaks(
            setpoint - _centre(setpoint), its, finest, 2, absolute=False, others=pull.shape[1]
        )
        found += [(height, column, frequency, width) for height, frequency, width in peaks]
    scored: list[tuple[float, float]] = []
    for _, column, frequency, width in sorted(found, reverse=True)[:_CLOSER]:
        one, its = setpoints[:, column], pull[:, column]
        step = _polished(one, its, _fine(one, its, frequency, width))
        scored.append((_significance(one, its, step), step))
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
    setpoint: Vector,
    pull: Vector,
    finest: float,
    count: int,
    *,
    absolute: bool,
    others: int = 1,
) -> list[tuple[float, float, float]]:
    """Highest scores above noise: height over noise, frequency 1/q, and distance of frequencies.

    Args:
        setpoint: Shape (N,) [A].
        pull: Shape (N,) [1/A].
        finest: Step below which nothing is looked for [A].
        count: How many to give at most.
        absolute: Whether zero is a multiple of the step; its phase is open otherwise.
        others: How many columns are looked at in the same way.
    """
    reach = float(np.max(np.abs(setpoint)))
    span = float(np.ptp(setpoint))
    if not span:
        return []
    width = max(finest / 4.0, 2.0 * reach / _BINS)
    bins = cast("int", next_fast_len(int(np.ceil(2.0 * reach / width)) + 2, real=True))
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
    first = min(usable, int(np.ceil(1.0 / (span * spacing))))
    score[:first] = 0.0  # coarser than the range
    if first == usable:
        return []
    # of normal numbers the highest is this; of the sizes of complex ones too
    noise = TO_SIGMA * float(np.median(np.abs(score[first:])))
    noise /= 1.0 if absolute else TO_SIGMA * float(np.sqrt(np.log(2.0)))
    highest = noise * float(np.sqrt((2.0 if absolute else 1.0) * np.log(others * usable)))
    peaks: list[tuple[float, float, float]] = []
    for _ in range(count):
        best = int(np.argmax(score))
        if score[best] <= highest:
            break
        peaks.append((float(score[best]) / (noise or 1.0), best * spacing, spacing))
        score[max(0, best - _APART) : best + _APART + 1] = 0.0
    return peaks


def _fine(setpoint: Vector, pull: Vector, frequency: float, width: float) -> float:
    """Find the needle among all whose multiples are right but for whole turns."""
    turn = 1.0 / float(np.max(np.abs(setpoint)))
    quarters = min(1000, int(np.ceil(4.0 * width / turn)))
    trials = frequency + 0.25 * turn * np.arange(-quarters, quarters + 1.0)
    # apart from the turns of its middle a column is smooth over all of them
    centre = _centre(setpoint)
    nodes = np.linspace(trials[0], trials[-1], _NODES)
    heights = np.zeros(len(trials))
    for harmonic in range(1, _HARMONICS + 1):
        course = np.exp(2j * np.pi * harmonic * np.outer(nodes, setpoint - centre)) @ pull
        turned = np.exp(2j * np.pi * harmonic * centre * trials)
        heights += (
            (-1.0) ** harmonic / harmonic * (CubicSpline(nodes, course)(trials) * turned).imag
        )
    near = 0.25 * turn * np.linspace(-0.75, 0.75, 7)
    closer = [1.0 / (trials[i] + near) for i in np.argsort(heights)[::-1][:_TRIED]]
    return _best(setpoint, pull, np.concatenate(closer))


def _centre(setpoint: Vector) -> float:
    return 0.5 * float(np.max(setpoint) + np.min(setpoint))


def _best(setpoints: Matrix, pull: Matrix, steps: Vector) -> float:
    return max(map(float, steps), key=lambda step: _significance(setpoints, pull, step))


def _polished(setpoints: Matrix, pull: Matrix, step: float) -> float:
    """Climb to the tip of a needle: it is a cusp, which no derivative finds."""
    turn = 1.0 / float(np.max(np.abs(setpoints)))
    for share in (0.06, 0.015):
        nearby = 1.0 / step + share * turn * np.linspace(-1.0, 1.0, 9)
        step = _best(setpoints, pull, 1.0 / nearby)
    return step


def _significance(setpoints: Matrix, pull: Matrix, step: float) -> float:
    """Score of a step per standard deviation, up to a constant."""
    error = np.round(setpoints / step) * step - setpoints
    return float(np.sum(pull * error) / (np.sqrt(np.sum(error**2)) or 1.0))
