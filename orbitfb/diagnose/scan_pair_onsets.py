"""Scan pairs of devices for the row from which on they are tied."""

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
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.scan_onsets import to_the_end
from orbitfb.diagnose.scan_shapes import Scoring
from orbitfb.effects.device_kinds import PairKind
from orbitfb.effects.kinds import Values
from orbitfb.physics.optics import Matrix

_PAIRS_TRIED = 12
"""Pairs whose beginning is looked for."""
_STRIDE = 4
"""Rows of which one is tried as the beginning of a leak: there are many pairs."""


def pair_onsets(
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
    for place in np.argsort(score)[::-1][:_PAIRS_TRIED]:
        pair = pairs[place]
        driven = drivers[:, pair] @ change[place].T
        pull = bench.slope @ patterns[:, pair]
        gains = [to_the_end(np.sum(pull * driven, axis=1))]
        if kind.of_changes:
            gains.append(gains[0] - np.sum(to_the_end(pull) * driven, axis=1))
        for level, shape in enumerate(scoring.ladder.shapes(patterns[:, pair])):
            seen = driven @ _root(shape.T @ shape)
            for first, gain in zip((seen, np.zeros_like(seen)), gains, strict=False):
                gain -= 0.5 * np.sum(scoring.begun(level, seen, first)[0], axis=1)
        for free, gain in enumerate(gains):
            gain[:FIRST_ONSET] = 0.0
            gain[len(gain) - LAST_ONSET :] = 0.0
            row = int(np.argmax(gain))
            if gain[row] > 0:
                values = {p.name: p.typical for p in kind.parameters}
                cause = Cause(kind, (int(place),), values, row, free=bool(free))
                yield Candidate(cause, float(gain[row]), float(choices[place] * len(gain)))


def mixing_onsets(
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
        parts: As for `pair_onsets`; both columns of a pair are seen in other readings.
        values: A small size of it.
        choices: Among how many each pair was chosen, shape (P,).
    """
    patterns, drivers, change = parts
    pairs = kind.pairs(bench.record.layout)
    shapes, pull = scoring.ladder.shapes(patterns), bench.slope @ patterns
    rows = len(drivers)
    frees = (False, True) if kind.of_changes else (False,)
    scores, infos = ([np.zeros((rows, len(pairs))) for _ in frees] for _ in range(2))
    for side in range(2):
        columns = pairs[:, side]
        driven = np.einsum("pb,kpb->kp", change[:, side], drivers[:, pairs])
        whole, later = to_the_end(pull[:, columns] * driven), to_the_end(pull[:, columns]) * driven
        for free, score, info in zip(frees, scores, infos, strict=True):
            score += whole - later if free else whole
            first = np.zeros_like(driven) if free else driven
            for level, shape in enumerate(shapes):
                size = np.sum(shape[:, columns] ** 2, axis=0)
                info += size * scoring.begun(level, driven, first)[0]
    for free, score, info in zip(frees, scores, infos, strict=True):
        strength, gain = best_strength(kind, score, info)
        gain[:FIRST_ONSET] = 0.0
        gain[rows - LAST_ONSET :] = 0.0
        best = np.argmax(gain, axis=0)
        height = gain[best, np.arange(len(pairs))]
        for place in np.argsort(height)[::-1][:KEPT]:
            begin = int(best[place])
            if height[place] > 0:
                scaled = sized(kind, values, float(strength[begin, place]))
                cause = Cause(kind, (int(place),), scaled, begin, free=free)
                yield Candidate(cause, float(height[place]), float(choices[place] * rows))


def leaks(kind: PairKind, share: str) -> bool:
    """Whether one column goes into the other and nothing comes back."""
    matrix = kind.matrix({share: 1.0})
    return matrix[1, 0] == 1.0 and matrix[0, 1] == 0.0 and matrix[0, 0] == matrix[1, 1]


def leak_onsets(
    bench: Bench, scoring: Scoring, kind: PairKind, share: str, choices: Vector, *, free: bool
) -> Iterator[Candidate]:
    """Try every few rows as the beginning of what leaks from any corrector into any other.

    The rows near the best ones are looked at closely.

    Args:
        bench: The record under the causes so far.
        scoring: On that bench.
        kind: The effect.
        share: Its parameter.
        choices: Among how many pairs each was chosen, shape (P,).
        free: Whether the kick of the second one is free when it begins; else it jumps by a share
            of the whole current.
    """
    record, currents = bench.record, bench.currents
    shapes, rows, count = scoring.correctors(), *currents.shape
    tried, first = np.arange(0, rows, _STRIDE), np.zeros_like(currents) if free else currents
    sizes = np.array([np.sum(shape**2, axis=0) for shape in shapes.fine])
    energies = np.array(
        [scoring.begun(level, currents, first)[0] for level in range(len(shapes.fine))]
    )
    # Single precision is enough to choose by.
    some = energies[:, tried].astype(np.float32)
    driven, pull = currents.astype(np.float32), shapes.pull.astype(np.float32)
    from_here = to_the_end(shapes.pull) if free else np.zeros_like(shapes.pull)
    pairs = kind.pairs(record.layout)
    height, begun = np.zeros((count, count)), np.zeros((count, count), dtype=np.intp)
    for second in np.unique(pairs[:, 1]):
        pulled = np.add.reduceat(driven * pull[:, [second]], tried)
        info = cast("Matrix", np.tensordot(sizes[:, second].astype(np.float32), some, 1))
        score = to_the_end(pulled) - currents[tried] * from_here[tried][:, [second]]
        gain = _inner(best_strength(kind, score, info)[1], rows, _STRIDE)
        best = np.argmax(gain, axis=0)
        height[:, second] = gain[best, np.arange(count)]
        begun[:, second] = tried[best]
    for place in np.argsort(height[pairs[:, 0], pairs[:, 1]])[::-1][:KEPT]:
        first, second = pairs[place]
        near = begun[first, second] + np.arange(1 - _STRIDE, _STRIDE)
        score = to_the_end(currents[:, first] * shapes.pull[:, second])
        score -= currents[:, first] * from_here[:, second]
        info = np.tensordot(sizes[:, second], energies[:, :, first], 1)
        strength, gain = best_strength(kind, score, info)
        row = int(near[np.argmax(_inner(gain, rows)[np.clip(near, 0, rows - 1)])])
        if 0 < row < rows and gain[row] > 0:
            values = sized(kind, {share: 1.0}, float(strength[row]))
            cause = Cause(kind, (int(place),), values, row, free=free)
            yield Candidate(cause, float(gain[row]), float(choices[place] * rows))


def _inner(gain: Matrix, rows: int, stride: int = 1) -> Matrix:
    """Gains of every so many rows, nothing where no effect may begin."""
    gain[: -(-FIRST_ONSET // stride)] = 0.0
    gain[(rows - LAST_ONSET) // stride :] = 0.0
    return gain


def _root(product: Matrix) -> Matrix:
    """Root R of a matrix of products, R Rᵀ, shape (2, 2)."""
    values, vectors = np.linalg.eigh(product)
    return vectors * np.sqrt(np.maximum(values, 0.0))
