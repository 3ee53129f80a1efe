"""BPMs that do not follow the beam: they read one number and their noise while the others move.

A BPM may stand at the node of one pattern in which the beam moves. That it stands at the nodes of
all of them has a chance: of each pattern, the share of the BPMs of its plane that read as little.
Where the beam is small in all patterns, as the β function makes it, it is not as small as that.
"""

import math
from collections.abc import Iterator

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.screen.steps import CHANCE
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.finding import Finding
from orbitfb.records.record import Record

_WINDOWS = 12
"""Parts of a record at whose beginnings a BPM is tried, to the end."""
_FEWEST = 100
"""Rows of the last part, at least, so that `_WHITE` holds."""
_WHITE = 1.4
"""Variance of readings over half of that of their changes, up to which they are white [1]: 1, and
four times the 1/√N by which that scatters in so many rows (J. von Neumann, Ann. Math. Statist. 12
(1941) 367)."""

_NOTHING = 1e-3
"""Energy of the patterns that a BPM reads, over that of the median one, up to which it is deaf [1]:
a β function of a thousandth of the usual one would read so little."""
_LOUD = 3.0
"""Size of a pattern in which the beam moves, rms over the rows, over the noise of a BPM [1]: noise
alone makes 1 + √(n/N), 2.3 with 180 BPMs in 100 rows."""


def check_deaf(record: Record) -> list[Finding]:
    """Find BPMs that read their noise alone, to the end of the record."""
    return [
        finding
        for plane in record.layout.planes
        for finding in _deaf(record, record.layout.bpms.in_plane(plane))
    ]


def _deaf(record: Record, columns: Indices) -> Iterator[Finding]:
    readings, told = record.readings[:, columns], set[int]()
    least = math.log(CHANCE / _WINDOWS / max(len(columns), 1))
    for begin in np.linspace(0, len(record), _WINDOWS, endpoint=False).astype(int).tolist():
        if len(record) - begin < _FEWEST:
            return
        moves = _moves(readings[begin:])
        white = (moves < _WHITE) & (moves > 1.0 / _WHITE)  # what repeats itself is told elsewhere
        white[list(told)] = False
        if not white.any():
            continue
        for place in np.flatnonzero(white & (_chances(readings[begin:]) <= least)).tolist():
            told.add(place)
            row = _onset(readings[:, place], begin)
            label = record.layout.bpms.label(int(columns[place]))
            text = (
                f"{label} reads {1e6 * float(readings[row:, place].mean()):.3f} µm and its noise "
                f"{f'from row {row} to the end' if row else 'all the time'}, while the beam moves"
            )
            rows = (row, len(record) - 1)
            yield Finding("deaf-bpm", "warning", (label,), rows, text, effect="bpm-stuck")


def _moves(readings: Matrix) -> Vector:
    """Variance of every BPM over half of that of its changes, shape (n,) [1]; 1 for white noise."""
    noise = 0.5 * np.var(np.diff(readings, axis=0), axis=0)
    return np.var(readings, axis=0) / np.maximum(noise, np.finfo(np.float64).tiny)


def _chances(readings: Matrix) -> Vector:
    """Logarithms of the chances that BPMs read so little of how they all move, shape (n,).

    Of one that reads more than nothing it is not asked: 0.
    """
    about = readings - readings.mean(axis=0)
    noise = 0.5 * np.var(np.diff(about, axis=0), axis=0)
    courses, size, _ = np.linalg.svd(about, full_matrices=False)
    moved = size**2 > _LOUD**2 * float(np.mean(noise)) * len(about)
    seen = np.maximum(np.abs(courses[:, moved].T @ about), np.sqrt(noise))
    less = np.sum(seen[:, None, :] <= seen[:, :, None], axis=2)
    energy = np.sum(seen**2, axis=0)
    nothing = energy <= _NOTHING * np.median(energy)
    return np.where(nothing, np.sum(np.log(less / seen.shape[1]), axis=0), 0.0)


def _onset(own: Vector, begin: int) -> int:
    """First row from which all readings are as far from their mean as noise is, at most."""
    late = own[begin:]
    most = np.abs(late - late.mean()).max()
    away = np.flatnonzero(np.abs(own[:begin] - late.mean()) > most)
    return int(away[-1]) + 1 if len(away) else begin
