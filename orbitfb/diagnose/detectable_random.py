"""What size of randomness a record would have shown: noise, strikes at single ticks, lines.

Noise is seen by the scatter of the squares that it enlarges: between rows, and between places, as
no device is exactly like the others. Of strikes the expected log-likelihood ratio is computed, of
a line the information on its amplitude.
"""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.randomness import projections
from orbitfb.effects.orbit_kinds import SourceKind
from orbitfb.effects.random_kinds import LatentKind, NoiseKind
from orbitfb.physics.optics import Matrix

SIGMA = 5.0
ENOUGH = 0.5 * SIGMA**2
"""Expected gain that counts as shown [nats]."""
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(12)
_ROWS = 300
_SHARES = 10 ** np.linspace(-6.0, 0.0, 37)
_SPREAD = 0.05
"""Relative scatter of a healthy variance between devices, beyond chance."""


def smallest_line(bench: Bench, kind: SourceKind) -> Vector:
    """Amplitude of a line that shows, at every frequency tried and every place, flat."""
    floor, record = bench.floor, bench.record
    frequency = np.linspace(0.02, 0.5, 25)
    turn = np.exp(-2j * np.pi * frequency)[:, None]
    response = np.abs((1.0 - turn) / (1.0 - (1.0 - floor.gains) * turn)) ** 2
    modal = (floor.modes.directions.T @ kind.patterns(record.layout)) ** 2
    info = (response / floor.innovation_variance) @ modal * (len(record) / 2.0)
    return np.ravel(SIGMA / np.sqrt(np.maximum(info, 1e-300)))


def smallest_noise(bench: Bench, kind: NoiseKind) -> Vector:
    """Size of noise that shows, as the distance of the first parameter from its nominal value.

    Returns:
        Of every place, shape (P,); one of an effect that all places have together.
    """
    patterns = kind.patterns(bench.record.layout)
    if not patterns.shape[1]:
        return np.zeros(0)
    if kind.colour == "walk":
        variance, usual = _walk(bench, kind, patterns)
    else:
        variance, usual = _white(bench, kind, patterns), float(np.sqrt(bench.floor.reading))
    nominal = kind.parameters[0].nominal
    return np.array([abs(kind.size(float(each), usual) - nominal) for each in variance])


def smallest_strike(bench: Bench, kind: LatentKind) -> float:
    """First parameter of an effect that strikes at random, at which it shows; NaN when none is."""
    floor = bench.floor
    shapes = kind.shapes(bench.record, bench.currents, bench.orbit)
    echo = (1.0 + floor.gains / (2.0 - floor.gains)) / floor.innovation_variance
    if kind.per_bpm:
        info = np.ravel(shapes**2 * (floor.modes.directions**2 @ echo))
    else:
        info = floor.to_modes(shapes) ** 2 @ echo
    weight = len(info) / _ROWS
    info = np.quantile(info, (np.arange(_ROWS) + 0.5) / _ROWS)
    spec = kind.parameters[0]
    if kind.strength == "normal":
        sizes = spec.high * 10 ** np.linspace(-8.0, 0.0, 81)
        gains = [weight * _normal_gain(info * size**2) for size in sizes]
    else:
        strength = 0.0 if kind.strength == "always one" else kind.parameters[1].typical
        sizes = _SHARES[spec.high >= _SHARES]
        gains = [weight * _rare_gain(info, float(share), strength) for share in sizes]
    found = np.flatnonzero(np.asarray(gains) > ENOUGH)
    return float(sizes[found[0]]) if len(found) else float("nan")


def _white(bench: Bench, kind: NoiseKind, patterns: Matrix) -> Vector:
    """κ that shows in the mean squares of rows, or in the products of neighbouring rows."""
    course, size = projections(bench, patterns)
    rows = len(course)
    if kind.lag:
        ratio = np.sum(course[kind.lag :] * course[: -kind.lag], axis=0) / rows / size
        return SIGMA * _spread(ratio, 1.0 / np.sqrt(rows)) / size
    logarithm = np.log(np.maximum(np.mean(course**2, axis=0) / size, 1e-6))
    return float(np.expm1(SIGMA * _spread(logarithm, np.sqrt(2.0 / rows)))) / size


def _walk(bench: Bench, kind: NoiseKind, patterns: Matrix) -> tuple[Vector, float]:
    """κ per tick that shows in the spectrum of the steps, and the usual rms of a place's steps.

    The spectrum of a mode is q + r² |1 − exp iω|². Its level is a nuisance of the floor; what
    would show is a change half-way, which has half the rows on either side: twice the deviation.
    """
    floor, rows = bench.floor, len(bench.record)
    wave = 2.0 - 2.0 * np.cos(np.linspace(0.01, np.pi, 200))
    spectrum = floor.walk[:, None] + floor.reading * wave
    modal = (floor.modes.directions.T @ patterns) ** 2
    usual = float(np.sqrt(np.sum(floor.walk) / np.sum(modal)))
    if kind.target == "ring":
        modal = modal.sum(axis=1, keepdims=True)
    info = 0.5 * rows * (np.mean(1.0 / spectrum**2, axis=1) @ modal**2)
    return 2.0 * SIGMA / np.sqrt(np.maximum(info, 1e-300)), usual


def _spread(values: Vector, chance: float) -> float:
    """Standard deviation between places, at least that of chance and of a healthy scatter."""
    middle = np.median(values)
    least = float(np.hypot(chance, _SPREAD))
    return max(least, 1.4826 * float(np.median(np.abs(values - middle))))


def _normal_gain(size: Vector) -> float:
    """Expected, of strikes of normal strength at every row; size is strength² · information."""
    return float(np.sum(0.5 * size - 0.5 * np.log1p(size)))


def _rare_gain(info: Vector, share: float, strength: float) -> float:
    """Expected, of strikes at a share of the rows, by Gauss–Hermite quadrature over the score."""
    share = min(share, 1.0 - 1e-9)
    root = np.sqrt(info)[:, None]
    size = (strength**2 * info)[:, None]

    def ratio(score: Matrix) -> Matrix:
        struck = score - 0.5 * info[:, None]
        if strength:
            struck = 0.5 * strength**2 * score**2 / (1.0 + size) - 0.5 * np.log1p(size)
        return np.logaddexp(np.log1p(-share), np.log(share) + struck)

    hit = root * np.sqrt(1.0 + size) * _NODES if strength else info[:, None] + root * _NODES
    mean = (1.0 - share) * ratio(root * _NODES) + share * ratio(hit)
    return float(np.sum(mean @ (_WEIGHTS / _WEIGHTS.sum())))
