"""BPMs that do not follow the beam: they read one number and their noise while the others move.

A BPM may stand at the node of one pattern in which the beam moves. That it stands at the nodes of
all of them has a chance, which is told from how little of each it reads, beside the rms of all BPMs:
with an orbit of normal numbers at a BPM, the chance of less than c of a rms a is erf(c / a√2).
"""

import math
from collections.abc import Iterator

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.screen.steps import CHANCE
from orbitfb.physics.optics import Matrix
from orbitfb.records.finding import Finding
from orbitfb.records.record import Record

_WINDOWS = 12
"""Parts of a record at whose beginnings a BPM is tried, to the end."""
_FEWEST = 100
"""Rows of the last part, at least: the variance of white readings is then known to a seventh."""
_WHITE = 1.4
"""Variance of readings over half of that of their changes, up to which they are white [1]: 1, and
three times what that scatters by in so many rows."""


def check_deaf(record: Record) -> list[Finding]:
    """Find BPMs that read their noise alone, to the end of the record."""
    return list(_deaf(record))


def _deaf(record: Record) -> Iterator[Finding]:
    readings, tried = record.readings, set[int]()
    for begin in np.linspace(0, len(record), _WINDOWS, endpoint=False).astype(int).tolist():
        if len(record) - begin < _FEWEST:
            return
        moves = _moves(readings[begin:])
        white = (moves < _WHITE) & (moves > 1.0 / _WHITE)  # what repeats itself is told elsewhere
        for column in sorted(set(np.flatnonzero(white).tolist()) - tried):
            if _chance(readings[begin:], column) > math.log(CHANCE / _WINDOWS / len(moves)):
                continue
            tried.add(column)
            row = _onset(readings[:, column], begin)
            label = record.layout.bpms.label(column)
            since = f"from row {row} to the end" if row else "all the time"
            text = (
                f"{label} reads {readings[row:, column].mean() * 1e6:.3f} µm and its noise {since}, "
                "while the beam moves"
            )
            rows = (row, len(record) - 1)
            yield Finding("deaf-bpm", "warning", (label,), rows, text, effect="bpm-stuck")


def _moves(readings: Matrix) -> Vector:
    """Variance of every BPM over half of that of its changes, shape (n,) [1]; 1 for white noise."""
    noise = 0.5 * np.var(np.diff(readings, axis=0), axis=0)
    return np.var(readings, axis=0) / np.maximum(noise, np.finfo(np.float64).tiny)


def _chance(readings: Matrix, column: int) -> float:
    """Logarithm of the chance that a BPM reads so little of how the others move."""
    about = readings - readings.mean(axis=0)
    others = np.delete(about, column, axis=1)
    noise = 0.5 * np.var(np.diff(others, axis=0), axis=0)
    courses, size, _ = np.linalg.svd(others, full_matrices=False)
    usual = size / math.sqrt(others.shape[1])  # of a pattern, rms over the BPMs, over all rows
    moved = usual > 3.0 * math.sqrt(float(np.mean(noise)) * len(about) / len(usual))
    own = np.abs(courses[:, moved].T @ about[:, column])
    own = np.maximum(own, float(np.std(about[:, column])))
    return sum(
        math.log(math.erf(seen / (math.sqrt(2.0) * one)))
        for seen, one in zip(own.tolist(), usual[moved].tolist(), strict=True)
    )


def _onset(own: Vector, begin: int) -> int:
    """First row from which all readings are as far from their mean as noise is, at most."""
    late = own[begin:]
    most = np.abs(late - late.mean()).max()
    away = np.flatnonzero(np.abs(own[:begin] - late.mean()) > most)
    return int(away[-1]) + 1 if len(away) else begin
