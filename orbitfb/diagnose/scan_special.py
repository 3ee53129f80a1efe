"""Scan what has no grid of places: the whole ring, a line of the spectrum, pairs of devices."""

from collections.abc import Iterator

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import (
    FIRST_ONSET,
    KEPT,
    LAST_ONSET,
    Candidate,
    best_strength,
    sized,
)
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.scan_shapes import Scoring
from orbitfb.effects.device_kinds import ActuatorKind, PairKind
from orbitfb.effects.kinds import Values
from orbitfb.effects.orbit_kinds import RingKind, SourceKind
from orbitfb.physics.optics import Matrix

_ONSETS_TRIED = 4
"""Onsets at which the information on an effect of the whole ring is computed."""
_PAIRS_TRIED = 12
"""Pairs whose beginning is looked for."""
_FINER = 4
"""Lines of the spectrum per line that the length of the record resolves."""


def of_ring(bench: Bench, scoring: Scoring, kind: RingKind | ActuatorKind) -> Iterator[Candidate]:
    """Try an effect on the whole ring, from the beginning and from every row on.

    Args:
        bench: The record under the causes so far.
        scoring: On that bench.
        kind: The effect.
    """
    for values in kind.grid(bench.record):
        if isinstance(kind, ActuatorKind):
            moved = kind.drive(bench.currents, values, bench.record) - bench.currents
            change = moved @ bench.record.layout.response.T
        else:
            change = kind.deflect(values, bench.record, bench.currents, bench.orbit)
        strength, gain = best_strength(kind, *scoring.whole(change))
        if gain[0] > 0:
            scaled = sized(kind, values, float(strength[0]))
            yield Candidate(Cause(kind, (), scaled), float(gain[0]), 1.0)
        if kind.sudden and not kind.grows:
            yield from _ring_onset(bench, scoring, kind, values, change)


def _ring_onset(
    bench: Bench, scoring: Scoring, kind: RingKind | ActuatorKind, values: Values, change: Matrix
) -> Iterator[Candidate]:
    """Try every row as the beginning of an effect on the whole ring."""
    rows = len(change)
    score = np.cumsum(np.sum(bench.slope * change, axis=1)[::-1])[::-1]
    tried = np.linspace(0.1, 0.9, _ONSETS_TRIED) * rows
    info = [scoring.seen(_from(change, int(row))) for row in tried]
    strength, gain = best_strength(kind, score, np.interp(np.arange(rows), tried, info))
    gain[:FIRST_ONSET] = 0.0
    gain[rows - LAST_ONSET :] = 0.0
    best = int(np.argmax(gain))
    if gain[best] > 0:
        scaled = sized(kind, values, float(strength[best]))
        yield Candidate(Cause(kind, (), scaled, best), float(gain[best]), float(rows))


def _from(change: Matrix, row: int) -> Matrix:
    later = change.copy()
    later[:row] = 0.0
    return later


def periodic(bench: Bench, kind: SourceKind) -> Iterator[Candidate]:
    """Find the line of one source: the Fourier transform of its score has all frequencies.

    Args:
        bench: The record under the causes so far.
        kind: The effect.
    """
    record = bench.record
    longest = max(record.stretches, key=lambda part: part.stop - part.start)
    rows = longest.stop - longest.start
    patterns = kind.patterns(record.layout)
    padded = _FINER * rows
    score = np.fft.rfft(bench.slope[longest] @ patterns, padded, axis=0)
    frequency = np.fft.rfftfreq(padded)
    feedback = 1.0 - bench.floor.gains
    turn = np.exp(-2j * np.pi * frequency)[:, None]
    response = np.abs((1.0 - turn) / (1.0 - feedback * turn)) ** 2
    weight = response / bench.floor.innovation_variance
    info = weight @ (bench.floor.modes.T @ patterns) ** 2 * (rows / 2.0)
    info[: 2 * _FINER] = np.inf  # fewer than two periods are a drift
    gain = 0.5 * np.abs(score) ** 2 / info
    best = np.argpartition(gain, -KEPT, axis=None)[-KEPT:]
    for flat in best:
        line, place = np.unravel_index(int(flat), gain.shape)
        size = score[line, place] / info[line, place]
        angle = 2 * np.pi * frequency[line] * longest.start
        size *= np.exp(1j * angle)  # the course is counted from the first row of the record
        yield Candidate(
            Cause(
                kind,
                (int(place),),
                {
                    "frequency": float(frequency[line] / record.layout.period),
                    "cosine": float(size.real),
                    "sine": float(-size.imag),
                },
            ),
            float(gain[line, place]),
            float(gain.size) / _FINER,
        )


def of_pairs(bench: Bench, scoring: Scoring, kind: PairKind) -> Iterator[Candidate]:
    """Try every pair of devices that an effect may tie.

    Args:
        bench: The record under the causes so far.
        scoring: On that bench.
        kind: The effect.
    """
    record = bench.record
    pairs = kind.pairs(record.layout)
    if not len(pairs):
        return
    if kind.target == "corrector":
        patterns, drivers = record.layout.response, bench.currents
    else:
        # What is not small has taken the predicted orbit with it: take the model's own.
        orbit = bench.orbit if kind.parameters else bench.currents @ record.layout.response.T
        patterns, drivers = np.eye(orbit.shape[1]), orbit
    scores = (bench.slope @ patterns).T @ drivers
    shapes, courses = scoring.ladder.shapes(patterns), scoring.courses(drivers)
    overlap = [(s.T @ s, c.T @ c) for s, c in zip(shapes, courses, strict=True)]
    for values in kind.grid(record):
        change = kind.matrices(record.layout, values) - np.eye(2)
        score = np.zeros(len(pairs))
        info = np.zeros(len(pairs))
        for a, b in np.ndindex(2, 2):
            score += change[:, a, b] * scores[pairs[:, a], pairs[:, b]]
            for c, d in np.ndindex(2, 2):
                factor = change[:, a, b] * change[:, c, d]
                if np.any(factor):
                    for shape, course in overlap:
                        info += (
                            factor
                            * shape[pairs[:, a], pairs[:, c]]
                            * course[pairs[:, b], pairs[:, d]]
                        )
        strength, gain = best_strength(kind, score, info)
        if kind.sudden and not kind.parameters:
            yield from _pair_onsets(bench, kind, (patterns, drivers, change), score)
        for place in np.argsort(gain)[::-1][:KEPT]:
            if gain[place] > 0:
                yield Candidate(
                    Cause(kind, (int(place),), sized(kind, values, float(strength[place]))),
                    float(gain[place]),
                    float(len(pairs)),
                )


def _pair_onsets(
    bench: Bench, kind: PairKind, parts: tuple[Matrix, Matrix, Matrix], score: Vector
) -> Iterator[Candidate]:
    """Try every row as the beginning, of the pairs with the largest scores.

    Args:
        bench: The record under the causes so far.
        kind: The effect.
        parts: Patterns (n, c) and drivers (N, c) of the columns, changes (P, 2, 2) of the pairs.
        score: Of the pairs over the whole record, shape (P,).
    """
    patterns, drivers, change = parts
    pairs = kind.pairs(bench.record.layout)
    for place in np.argsort(score)[::-1][:_PAIRS_TRIED]:
        pair = pairs[place]
        moved = (drivers[:, pair] @ change[place].T) @ patterns[:, pair].T
        white = bench.floor.whiten(moved, bench.record.starts)
        by_row = np.sum(bench.slope * moved, axis=1) - 0.5 * np.sum(white**2, axis=1)
        gain = np.cumsum(by_row[::-1])[::-1]
        gain[:FIRST_ONSET] = 0.0
        gain[len(gain) - LAST_ONSET :] = 0.0
        row = int(np.argmax(gain))
        if gain[row] > 0:
            values = {p.name: p.typical for p in kind.parameters}
            choices = float(len(pairs) * len(gain))
            yield Candidate(Cause(kind, (int(place),), values, row), float(gain[row]), choices)
