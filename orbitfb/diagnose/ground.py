"""How the ground moves the quadrupoles: each alone, with its neighbours, or as it diffuses.

Only the directions of the modes follow from it; how far each of them walks is estimated with the
record. The wrong directions let one mode go along with another, which looks like an energy, a
crate or a corrector that wanders.

The diffusion is the ATL law, in which two places move apart as the square root of time and
distance (V. Shiltsev, Phys. Rev. ST Accel. Beams 13 (2010) 094801).
"""

import itertools
from collections.abc import Iterator

import numpy as np
from scipy.fft import dst

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.floor import estimate_floor
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.diagnose.noise_modes import GROUNDS, NoiseModes
from orbitfb.physics.optics import Matrix
from orbitfb.records.layout import Layout

_BANDS = 24
"""Bands of the spectrum, alike in the logarithm of the frequency."""
_RATIOS = np.exp(np.linspace(-13.0, 10.0, 70))
"""Ratios q / r² that a mode is tried with."""
_SURE = 20.0
"""What it takes to leave the shape that a record had so far [nats]."""
_LOUD = 1.5
"""Mean square of a row over the usual one from which something else than the ground moved it."""
_FEWEST = 200
"""Quiet rows that tell a shape."""


def settled(left: Matrix, starts: Mask, layout: Layout, floor: NoiseFloor) -> NoiseFloor:
    """Find the floor of the ground that makes what is left likeliest; BPMs stay as noisy as told.

    Args:
        left: What the model and healthy errors leave, shape (N, n) [m].
        starts: Where stretches begin, shape (N,).
        layout: Devices.
        floor: In the modes so far.
    """
    modes = floor.modes
    if layout.ring is None:
        return floor
    squares = np.sum(floor.whiten(left, starts) ** 2, axis=1)
    quiet = ~starts & (squares < _LOUD * np.median(squares[~starts]))
    if quiet.sum() < _FEWEST:
        return floor
    steps = np.diff(left / modes.spread, axis=0)[quiet[1:]]
    spectrum = _spectrum(steps)
    best, height = modes, _likelihood(modes.axes, *spectrum, floor.reading) + _SURE
    for other in _others(layout, modes):
        there = _likelihood(other.axes, *spectrum, floor.reading)
        if there > height:
            best, height = other, there
    return floor if best is modes else estimate_floor(left, starts, best)


def _others(layout: Layout, modes: NoiseModes) -> Iterator[NoiseModes]:
    for ground in GROUNDS:
        if ground != modes.ground:
            yield NoiseModes.of(layout, modes.spread, modes.scatter, modes.deaf, ground)


def _spectrum(steps: Matrix) -> tuple[list[Matrix], Vector, Vector]:
    """Average the spectrum of the steps from row to row, (N, n) [m], over bands.

    The covariance of the steps of a walk with reading noise is tridiagonal: its eigenvectors are
    sines, whatever the two amount to, so that the lines are independent.

    Returns:
        Of every band the products of the lines, (n, n) [m²]; the number of lines; and the mean of
        what a step makes of white noise, (B,).
    """
    lines = np.asarray(dst(steps, type=1, axis=0, norm="ortho"))
    count = len(lines)
    drawn = 4.0 * np.sin(0.5 * np.pi * np.arange(1, count + 1) / (count + 1)) ** 2
    edges = np.unique(np.geomspace(1, count + 1, _BANDS + 1).astype(np.intp)) - 1
    parts = [slice(begin, end) for begin, end in itertools.pairwise(edges)]
    counts = np.array([float(part.stop - part.start) for part in parts])
    powers = [lines[part].T @ lines[part] / many for part, many in zip(parts, counts, strict=True)]
    return powers, counts, np.array([float(np.mean(drawn[part])) for part in parts])


def _likelihood(
    axes: Matrix, powers: list[Matrix], counts: Vector, drawn: Vector, reading: float
) -> float:
    """Log-likelihood of walks beside a reading noise, every walk as large as it is likely."""
    seen = np.array([np.sum((power @ axes) * axes, axis=0) for power in powers])
    expected = reading * (_RATIOS[:, None] + drawn)
    cost = (counts / expected) @ seen + np.sum(counts * np.log(expected), axis=1)[:, None]
    return -0.5 * float(np.sum(cost.min(axis=0)))
