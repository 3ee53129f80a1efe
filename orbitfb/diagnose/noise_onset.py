"""From when on there is more noise (or less): before that the places are their own reference."""

from dataclasses import replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.randomness import EDGE, beyond_healthy, projections, usual_reading, values_of
from orbitfb.effects.random_kinds import NoiseKind

_ONSET_WORTH = 4.0
"""Gain of a beginning beyond the price of its choice [nats]."""


def begun_noise(bench: Bench, candidate: Candidate) -> Candidate:
    """Let a noise begin at the row that explains the record best, if it was not always there.

    Args:
        bench: The record under the causes accepted so far.
        candidate: With a noise that has places; another is given back as it is.
    """
    cause, kind = candidate.cause, candidate.cause.kind
    if not isinstance(kind, NoiseKind) or not kind.sudden or cause.onset or not cause.places:
        return candidate
    if kind.lag or kind.rare or kind.colour == "walk" or candidate.group == "all":
        return candidate
    course, size = projections(bench, kind.patterns(bench.record.layout)[:, list(cause.places)])
    squares = course**2 / size
    row, gain, ratio = split(squares.mean(axis=1), len(cause.places))
    beyond = gain - float(np.log(len(squares)))
    if beyond < _ONSET_WORTH:
        return candidate
    early, late = squares[:row].mean(axis=0), squares[row:].mean(axis=0)
    reading = usual_reading(bench, kind, np.array(cause.places))
    values = values_of(kind, float(np.mean((late - early) / size)), reading)
    if values is None:
        return candidate
    sure = float(beyond_healthy(np.array([beyond]), np.array([ratio]))[0])
    alone = None if candidate.alone is None else candidate.alone + beyond
    return replace(
        candidate,
        cause=replace(cause, values=values, onset=row),
        gain=max(candidate.gain, sure),
        alone=alone,
    )


def split(squares: Vector, members: int) -> tuple[int, float, float]:
    """Find the row that parts a course of squares best into two of a variance each.

    Args:
        squares: Mean square of the members' white noise, shape (N,).
        members: How many there are.

    Returns:
        First row of the later part, gain over one variance for all [nats], and the ratio of the
        later variance to the earlier one.
    """
    rows = len(squares)
    before = np.cumsum(squares)
    count = np.arange(1, rows + 1)
    left = np.maximum(rows - count, 1)
    early = np.maximum(before / count, 1e-9)
    late = np.maximum((before[-1] - before) / left, 1e-9)
    whole = rows * np.log(before[-1] / rows)
    gain = 0.5 * members * (whole - count * np.log(early) - left * np.log(late))
    gain[:EDGE] = 0.0
    gain[-EDGE:] = 0.0
    best = int(np.argmax(gain))
    return best + 1, float(gain[best]), float(late[best] / early[best])
