"""Scan pairs of devices: those that are exchanged, and those that one leaks into the other."""

from collections.abc import Iterator, Sequence

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import KEPT, Candidate, best_strength, sized
from orbitfb.diagnose.explain import Cause, restored
from orbitfb.diagnose.scan_pair_onsets import leak_onsets, leaks, mixing_onsets, pair_onsets
from orbitfb.diagnose.scan_shapes import Scoring
from orbitfb.effects.device_kinds import PairKind
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout

_LOOKED_AT = 24
"""Currents, and then pairs, of which it is found out what healthy errors leave."""
_LEAST_LEFT = 1e-3
"""Information below which nothing is left of a pair."""
_PROMISING = 10.0
"""Gain of the best of them from which it is worth the time [nats]."""


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
            yield from pair_onsets(bench, scoring, kind, parts, score, choices)
        if kind.sudden and kind.linear is not None:
            if kind.target == "corrector" and leaks(kind, kind.linear):
                for free in (False, True) if kind.of_changes else (False,):
                    yield from leak_onsets(bench, scoring, kind, kind.linear, choices, free=free)
            else:
                yield from mixing_onsets(bench, scoring, kind, parts, values, choices)
        if kind.linear is not None and kind.target == "corrector" and gain.max() > _PROMISING:
            gain = gain / _beyond_its_gain(bench, overlap, pairs)
            strength, gain = _beside_healthy(bench, parts, pairs, score, gain)
        for place in np.argsort(gain)[::-1][:KEPT]:
            if gain[place] > 0:
                yield Candidate(
                    Cause(kind, (int(place),), sized(kind, values, float(strength[place]))),
                    float(gain[place]),
                    float(choices[place]),
                )


def _beyond_its_gain(
    bench: Bench, overlap: Sequence[tuple[Matrix, Matrix]], pairs: Indices
) -> Vector:
    """Share of what leaks that the healthy gain of the corrector it comes from cannot be, (P,).

    Next to that corrector most of it is, and what is left shows one that leaks best.

    Args:
        bench: The record under the causes so far.
        overlap: Products of the orbits and of the courses of all correctors, level by level.
        pairs: From, to.
    """
    first, second = pairs[:, 0], pairs[:, 1]
    levels = [(alike, np.diagonal(driven)[first]) for alike, driven in overlap]
    both = sum(alike[first, second] * driven for alike, driven in levels)
    own, other = (
        sum(np.diagonal(alike)[side] * driven for alike, driven in levels)
        for side in (first, second)
    )
    share = np.clip(both**2 / np.maximum(own * other, 1e-300), 0.0, 1.0)
    beyond = 1.0 - share * bench.background.absorbed("correctors")[first]
    return np.maximum(beyond, _LEAST_LEFT)


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
