"""From when on there is more noise (or less): before that the places are their own reference."""

from dataclasses import replace

import numpy as np

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.noise_spectra import usual_reading
from orbitfb.diagnose.randomness import (
    beyond_healthy,
    parted,
    projections,
    values_of,
)
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
    rows, gain, before, after = parted(squares.mean(axis=1, keepdims=True), len(cause.places))
    row = int(rows[0])
    beyond = float(gain[0]) - float(np.log(len(squares)))
    if beyond < _ONSET_WORTH:
        return candidate
    early, late = squares[:row].mean(axis=0), squares[row:].mean(axis=0)
    reading = usual_reading(bench, kind, np.array(cause.places))
    values = values_of(kind, float(np.mean((late - early) / size)), reading)
    if values is None:
        return candidate
    sure = float(beyond_healthy(np.array([beyond]), after / before)[0])
    alone = None if candidate.alone is None else candidate.alone + beyond
    return replace(
        candidate,
        cause=replace(cause, values=values, onset=row),
        gain=max(candidate.gain, sure),
        alone=alone,
    )
