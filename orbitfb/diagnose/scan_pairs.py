"""Scan pairs of devices: those that are exchanged, and those that one leaks into the other."""

from collections.abc import Iterator
from typing import cast

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
from orbitfb.diagnose.explain import Cause, restored
from orbitfb.diagnose.scan_onsets import short, to_the_end
from orbitfb.diagnose.scan_shapes import Scoring
from orbitfb.effects.device_kinds import PairKind
from orbitfb.effects.kinds import Values
from orbitfb.effects.layout import Layout
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

_PAIRS_TRIED = 12
"""Pairs whose beginning is looked for."""
_LOOKED_AT = 24
"""Currents, and then pairs, of which it is found out what healthy errors leave."""
_LEAST_LEFT = 1e-3
"""Information below which nothing is left of a pair."""
_PROMISING = 10.0
"""Gain of the best of them from which it is worth the time [nats]."""
_STRIDE = 4
"""Rows of which one is tried as the beginning of a leak: there are many pairs."""


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
        orbit = bench.orbit
        if not kind.parameters:
            # What is not small has taken the predicted orbit with it. What is its own inverse, S,
            # changes readings y by (S − 1) S y = (S − 1)(−y), with the gain to second order exact.
            orbit = -restored(record, bench.causes)[0]
        patterns, drivers = np.eye(orbit.shape[1]), orbit
    choices = _choices(kind, record.layout)
    scores = (bench.slope @ patterns).T @ drivers
    shapes, courses = scoring.ladder.shapes(patterns), scoring.courses(drivers)
    overlap = [(s.T @ s, c.T @ c) for s, c in zip(shapes, courses, strict=True)]
    for values in kind.grid(record):
        change = kind.matrices(record.layout, values) - np.eye(2)
        parts = patterns, drivers, change
        score, info = np.zeros(len(pairs)), np.zeros(len(pairs))
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
            yield from _pair_onsets(bench, scoring, kind, parts, score, choices)
        if kind.sudden and kind.linear is not None:
            if kind.target == "corrector" and _leaks(kind, kind.linear):
                yield from _leak_onsets(bench, scoring, kind, kind.linear, choices)
            else:
                yield from _mixing_onsets(bench, scoring, kind, parts, values, choices)
        if kind.linear is not None and kind.target == "corrector" and gain.max() > _PROMISING:
            strength, gain = _beside_healthy(bench, parts, pairs, score, gain)
        for place in np.argsort(gain)[::-1][:KEPT]:
            if gain[place] > 0:
                yield Candidate(
                    Cause(kind, (int(place),), sized(kind, values, float(strength[place]))),
                    float(gain[place]),
                    float(choices[place]),
                )


def _beside_healthy(
    bench: Bench,
    parts: tuple[Matrix, Matrix, Matrix],
    pairs: Indices,
    score: Vector,
    gain: Vector,
) -> tuple[Vector, Vector]:
    """Strengths and gains of the best pairs once healthy errors have done their best beside each.

    What one current does to the whole orbit, healthy optics do in part: how much of it they leave
    depends on that current more than on the corrector that it leaks into.

    Returns:
        Strength and gain (P,), zero of pairs that are not among the best.
    """
    patterns, drivers, change = parts

    def known(place: int) -> float:
        pair = pairs[place]
        return bench.information((drivers[:, pair] @ change[place].T) @ patterns[:, pair].T)

    order = np.argsort(gain)[::-1]
    currents, at = np.unique(pairs[order, 0], return_index=True)
    best = order[at]  # pair of every current, in the order of `currents`
    steered = np.var(drivers[:, currents], axis=0)
    promise = gain[best] * (1.0 + steered / max(float(np.mean(steered)), 1e-300))
    thought = 0.5 * score**2 / np.maximum(gain, 1e-300)  # information without healthy errors
    estimated = np.zeros_like(gain)
    for index in np.argsort(promise)[::-1][:_LOOKED_AT]:
        if gain[best[index]] <= 0.0:
            continue
        left = known(int(best[index])) / thought[best[index]]
        mine = pairs[:, 0] == currents[index]
        estimated[mine] = gain[mine] / max(left, _LEAST_LEFT)
    strength, better = np.zeros_like(gain), np.zeros_like(gain)
    for place in np.argsort(estimated)[::-1][:_LOOKED_AT]:
        information = known(int(place)) if estimated[place] > 0.0 else 0.0
        if information <= _LEAST_LEFT:
            continue
        strength[place] = score[place] / information
        better[place] = 0.5 * score[place] ** 2 / information
    return strength, better


def _choices(kind: PairKind, layout: Layout) -> Vector:
    """Among how many pairs each was chosen, shape (P,).

    What stands in one cell shares racks, cables and rails: half of what happens to pairs happens
    within a cell.
    """
    devices = layout.correctors if kind.target == "corrector" else layout.bpms
    cells = np.array(devices.cells, dtype=object)
    pairs = kind.pairs(layout)
    near = (cells[pairs[:, 0]] == cells[pairs[:, 1]]) & (cells[pairs[:, 0]] != "")
    both = 1.0 if near.all() or not near.any() else 2.0
    return both * np.where(near, np.sum(near), np.sum(~near))


def _pair_onsets(
    bench: Bench,
    scoring: Scoring,
    kind: PairKind,
    parts: tuple[Matrix, Matrix, Matrix],
    score: Vector,
    choices: Vector,
) -> Iterator[Candidate]:
    """Try every row as the beginning, of the pairs with the largest scores.

    Args:
        bench: The record under the causes so far.
        scoring: On that bench.
        kind: The effect.
        parts: Patterns (n, c) and drivers (N, c) of the columns, changes (P, 2, 2) of the pairs.
        score: Of the pairs over the whole record, shape (P,).
        choices: Among how many each was chosen, shape (P,).
    """
    patterns, drivers, change = parts
    pairs = kind.pairs(bench.record.layout)
    brief = short(len(drivers))
    for place in np.argsort(score)[::-1][:_PAIRS_TRIED]:
        pair = pairs[place]
        driven = drivers[:, pair] @ change[place].T
        gain = to_the_end(np.sum((bench.slope @ patterns[:, pair]) * driven, axis=1))
        for shape, course, feedback in zip(
            scoring.ladder.shapes(patterns[:, pair]),
            scoring.courses(driven),
            scoring.ladder.feedback,
            strict=True,
        ):
            jump = np.sum((driven @ shape.T) ** 2, axis=1) / (1.0 - feedback**2 + brief)
            gain -= 0.5 * (to_the_end(np.sum((course @ shape.T) ** 2, axis=1)) + jump)
        gain[:FIRST_ONSET] = 0.0
        gain[len(gain) - LAST_ONSET :] = 0.0
        row = int(np.argmax(gain))
        if gain[row] > 0:
            values = {p.name: p.typical for p in kind.parameters}
            cause = Cause(kind, (int(place),), values, row)
            yield Candidate(cause, float(gain[row]), float(choices[place] * len(gain)))


def _mixing_onsets(
    bench: Bench,
    scoring: Scoring,
    kind: PairKind,
    parts: tuple[Matrix, Matrix, Matrix],
    values: Values,
    choices: Vector,
) -> Iterator[Candidate]:
    """Try every row as the beginning of what mixes two columns by a size: they then jump.

    Args:
        bench: The record under the causes so far.
        scoring: On that bench.
        kind: The effect.
        parts: As for `_pair_onsets`; both columns of a pair are seen in other readings.
        values: A small size of it.
        choices: Among how many each pair was chosen, shape (P,).
    """
    patterns, drivers, change = parts
    pairs = kind.pairs(bench.record.layout)
    shapes, pull = scoring.ladder.shapes(patterns), bench.slope @ patterns
    rows = len(drivers)
    brief = short(rows)
    score, info = np.zeros((rows, len(pairs))), np.zeros((rows, len(pairs)))
    for side in range(2):
        columns = pairs[:, side]
        driven = np.einsum("pb,kpb->kp", change[:, side], drivers[:, pairs])
        score += to_the_end(pull[:, columns] * driven)
        for shape, course, feedback in zip(
            shapes, scoring.courses(driven), scoring.ladder.feedback, strict=True
        ):
            size = np.sum(shape[:, columns] ** 2, axis=0)
            info += size * to_the_end(course**2)
            info += size * driven**2 / (1.0 - feedback**2 + brief)[:, None]
    strength, gain = best_strength(kind, score, info)
    gain[:FIRST_ONSET] = 0.0
    gain[rows - LAST_ONSET :] = 0.0
    best = np.argmax(gain, axis=0)
    height = gain[best, np.arange(len(pairs))]
    for place in np.argsort(height)[::-1][:KEPT]:
        begin = int(best[place])
        if height[place] > 0:
            scaled = sized(kind, values, float(strength[begin, place]))
            cause = Cause(kind, (int(place),), scaled, begin)
            yield Candidate(cause, float(height[place]), float(choices[place] * rows))


def _leaks(kind: PairKind, share: str) -> bool:
    """Whether one column goes into the other and nothing comes back."""
    matrix = kind.matrix({share: 1.0})
    return matrix[1, 0] == 1.0 and matrix[0, 1] == 0.0 and matrix[0, 0] == matrix[1, 1]


def _leak_onsets(
    bench: Bench, scoring: Scoring, kind: PairKind, share: str, choices: Vector
) -> Iterator[Candidate]:
    """Try every few rows as the beginning of what leaks from any corrector into any other.

    A share of the whole current leaks, so that the kick of the second one jumps there: the rows
    near the best ones are looked at closely.
    """
    record, currents = bench.record, bench.currents
    shapes, rows, count = scoring.correctors(), *currents.shape
    brief, tried = short(rows), np.arange(0, rows, _STRIDE)
    sizes = np.array([np.sum(shape**2, axis=0) for shape in shapes.fine])
    levels = zip(scoring.courses(currents), scoring.ladder.feedback, strict=True)
    energies = np.array(
        [
            to_the_end(course**2) + currents**2 / (1.0 - feedback**2 + brief)[:, None]
            for course, feedback in levels
        ]
    )
    # Single precision is enough to choose by.
    some = energies[:, tried].astype(np.float32)
    driven, pull = currents.astype(np.float32), shapes.pull.astype(np.float32)
    pairs = kind.pairs(record.layout)
    height, begun = np.zeros((count, count)), np.zeros((count, count), dtype=np.intp)
    for second in np.unique(pairs[:, 1]):
        pulled = np.add.reduceat(driven * pull[:, [second]], tried)
        info = cast("Matrix", np.tensordot(sizes[:, second].astype(np.float32), some, 1))
        gain = _inner(best_strength(kind, to_the_end(pulled), info)[1], rows, _STRIDE)
        best = np.argmax(gain, axis=0)
        height[:, second] = gain[best, np.arange(count)]
        begun[:, second] = tried[best]
    for place in np.argsort(height[pairs[:, 0], pairs[:, 1]])[::-1][:KEPT]:
        first, second = pairs[place]
        near = begun[first, second] + np.arange(1 - _STRIDE, _STRIDE)
        score = to_the_end(currents[:, first] * shapes.pull[:, second])
        info = np.tensordot(sizes[:, second], energies[:, :, first], 1)
        strength, gain = best_strength(kind, score, info)
        row = int(near[np.argmax(_inner(gain, rows)[np.clip(near, 0, rows - 1)])])
        if 0 < row < rows and gain[row] > 0:
            cause = Cause(kind, (int(place),), sized(kind, {share: 1.0}, float(strength[row])), row)
            yield Candidate(cause, float(gain[row]), float(choices[place] * rows))


def _inner(gain: Matrix, rows: int, stride: int = 1) -> Matrix:
    """Gains of every so many rows, nothing where no effect may begin."""
    gain[: -(-FIRST_ONSET // stride)] = 0.0
    gain[(rows - LAST_ONSET) // stride :] = 0.0
    return gain
