"""Readings that were not read: drawn from what the readings around them say.

A reading that is filled in with what is most likely is quieter than one that was read, and every
law of the noise finds that. One that is drawn, walk and noise included, is like all others; it says
nothing of its own (M. Tanner, W. Wong, J. Am. Stat. Assoc. 82 (1987) 528). Each BPM is taken for
itself: a walk read with noise, with the model's changes added. What jumps is not smoothed: a jump
that the model does not tell would else begin rows before it. The draw is a smoother's (J. Durbin,
S. Koopman, Biometrika 89 (2002) 603), and the same for the same record.
"""

from dataclasses import replace

import numpy as np

from orbitfb.core.robust import TO_SIGMA
from orbitfb.core.signals import FINEST, Mask, Vector
from orbitfb.estimation.transform import Matrix
from orbitfb.records.record import Record

_FEWEST = 10
"""Pairs of readings by which walk and noise of a BPM are told; with fewer it has the others'."""

_FAR = 8
"""Rows apart at which a walk shows beside the noise."""
_JUMP = 5.0
"""Standard deviations from which a change is a jump [1]: one reading in two million is so far off
by chance."""
_ANYWHERE = 1e18
"""Variance of a reading of which nothing is known, over that of the noise [1]: 200 m at 0.2 µm, so
that no reading is a jump because a stretch begins there."""
_LEAST = 1e-4
"""Least part of walk and of noise in what changes from row to row [1]."""


def drawn(record: Record, told: Matrix | float = 0.0) -> Record:
    """Fill in what was not read: `filled` tells which readings.

    Args:
        record: Readings that were not read have any finite value.
        told: What is known of the readings beside the model, shape (N, n) [m].

    Returns:
        The same, its missing readings drawn; `filled` still tells which they are.
    """
    missing = record.filled
    columns = np.flatnonzero(missing.any(axis=0) & ~missing.all(axis=0))
    if not len(columns):
        return record
    modelled = record.setpoints @ record.layout.response.T + told
    left, known = (record.readings - modelled)[:, columns], ~missing[:, columns]
    walk, noise = _spread(left, known, record.starts)
    rng = np.random.default_rng(len(record))
    noise = np.maximum(noise, FINEST**2)
    moves = _moves(left / np.sqrt(noise), known, walk / noise, record.starts)
    steps = np.sqrt(noise * moves) * rng.standard_normal(left.shape)
    orbit = np.cumsum(steps, axis=0)
    read = orbit + np.sqrt(noise) * rng.standard_normal(left.shape)
    found = read + _smoothed(left - read, known, moves, record.starts)
    readings = record.readings.copy()
    readings[:, columns] = np.where(known, readings[:, columns], found + modelled[:, columns])
    return replace(record, readings=readings)


def _spread(left: Matrix, known: Mask, starts: Mask) -> tuple[Vector, Vector]:
    """Variance of the walk per row, and of the noise, of every BPM, shape (k,) each [m²].

    Readings that are d rows apart differ by 2v + d q on average. Where no stretch is long enough
    for a walk to show, there is none.
    """
    near = _change(left, known, starts, 1) ** 2
    far = _change(left, known, starts, _FAR) ** 2
    near = np.where(np.isfinite(near), near, 2.0 * np.var(left, axis=0, where=known))
    far = np.where(np.isfinite(far), far, near)
    least = _LEAST * near
    walk = np.clip((far - near) / (_FAR - 1), least, near - least)
    return walk, 0.5 * (near - walk)


def _change(left: Matrix, known: Mask, starts: Mask, apart: int) -> Vector:
    """Usual change over some rows, shape (k,) [m]; NaN where no BPM has enough of them."""
    both = known[apart:] & known[:-apart]
    for row in range(apart):
        both &= ~starts[1 + row : len(starts) - apart + 1 + row, None]
    away = np.abs(left[apart:] - left[:-apart])
    several = both.sum(axis=0) >= _FEWEST
    found = np.full(left.shape[1], np.nan)
    for column in np.flatnonzero(several):
        found[column] = TO_SIGMA * np.median(away[both[:, column], column])
    return np.where(several, found, np.median(found[several])) if several.any() else found


def _moves(left: Matrix, known: Mask, ratio: Vector, starts: Mask) -> Matrix:
    """Variance of every step of a walk over that of the noise, jumps included, shape (N, k).

    A jump is where a reading is far from what those before it say. If readings are missing before
    it, it was where most other BPMs jump, or at the last row.

    Args:
        left: Readings less the model over the standard deviation of their noise, shape (N, k).
        known: Which of them were read.
        ratio: Variance of the walk per row over that of the noise, shape (k,).
        starts: First rows of stretches, shape (N,).
    """
    moves = np.tile(ratio, (len(left), 1))
    jumps: list[tuple[int, int, int, float]] = []
    state, last = np.zeros(left.shape[1]), np.zeros(left.shape[1], int)
    width = np.full(left.shape[1], _ANYWHERE)
    for row, begins in enumerate(starts.tolist()):
        width = np.full(left.shape[1], _ANYWHERE) if begins else width + ratio
        last[:] = row - 1 if begins else last
        away = left[row] - state
        over = np.where(known[row], away**2 - _JUMP**2 * (width + 1.0), -1.0)
        for column in np.flatnonzero(over > 0.0).tolist():
            more = float(away[column] ** 2)
            jumps.append((last[column] + 1, row, column, more))
            width[column] += more
        gain = np.where(known[row], width / (width + 1.0), 0.0)
        state, width = state + gain * away, np.where(known[row], gain, width)
        last[known[row]] = row
    sure = np.bincount([row for first, row, _, _ in jumps if first == row], minlength=len(left))
    for first, row, column, more in jumps:
        others = sure[first : row + 1][::-1]
        moves[row - int(np.argmax(others)), column] += more
    return moves


def _smoothed(left: Matrix, known: Mask, moves: Matrix, starts: Mask) -> Matrix:
    """Mean of a walk that readings tell, those missing left out, shape (N, k) [m].

    A filter forwards and the smoother of H. Rauch, F. Tung, C. Striebel (AIAA J. 3 (1965) 1445)
    backwards; a stretch begins anywhere.

    Args:
        left: Readings less the model, shape (N, k) [m].
        known: Which of them were read.
        moves: Variance of every step of the walk over that of the noise, shape (N, k).
        starts: First rows of stretches, shape (N,).
    """
    mean, spread = np.zeros_like(left), np.zeros_like(left)
    state, width = np.zeros(left.shape[1]), np.full(left.shape[1], _ANYWHERE)
    for row, begins in enumerate(starts.tolist()):
        width = np.full(left.shape[1], _ANYWHERE) if begins else width + moves[row]
        gain = np.where(known[row], width / (width + 1.0), 0.0)
        state = state + gain * (left[row] - state)
        width = np.where(known[row], gain, width)
        mean[row], spread[row] = state, width
    for row in range(len(left) - 2, -1, -1):
        if not starts[row + 1]:
            back = spread[row] / (spread[row] + moves[row + 1])
            mean[row] += back * (mean[row + 1] - mean[row])
    return mean
