"""Effects without a course in time: noise that is larger, shared or coloured.

With g = S⁻¹ e, adding κ b bᵀ to the covariance of the innovations changes the log-likelihood by
−½ N log(1 + κ a) + ½ κ / (1 + κ a) Σ (bᵀ g)², a = bᵀ S⁻¹ b (matrix determinant lemma), which is
largest where 1 + κ a is the mean of (bᵀ g)² / a.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import comb

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import Candidate, held_to
from orbitfb.diagnose.device_groups import Group, crates, membership
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.healthy_levels import WITHIN
from orbitfb.diagnose.noise_colour import colour_of_all
from orbitfb.diagnose.noise_spectra import usual_reading
from orbitfb.diagnose.noise_walk import walking_candidates
from orbitfb.diagnose.switching import switching_candidates
from orbitfb.effects.kinds import Values
from orbitfb.effects.random_kinds import NoiseKind
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

_LEAST_SCATTER = 0.05
"""Relative scatter of a healthy variance between devices, beyond chance."""
LEAST_COLOUR = 0.02
"""The same of a correlation in time: levels of healthy noise differ, but all of it is white."""
LEVELS = ("noise-level", "ground-motion-level")
"""Kinds that may strike every place alike."""
_KEPT = 3
_AT_ONCE = 500
"""Groups that are looked at in one go: every row of each is a number."""
_MANY = 8
"""Places from which on a typical one can be told."""
EDGE = 60
"""Rows at both ends of a record within which no level changes."""
_STRIKING = 5.0
"""Standard deviations from which a place is struck for itself, wherever the others stand."""
_IN_COMMON = 1 / 3
"""Share of the wandering of healthy levels that neighbours have in common."""
_MANY_STRIKE = 0.25
"""Share of all places beyond which they are no exceptions."""


def noise_candidates(bench: Bench, kind: NoiseKind) -> list[Candidate]:
    """Find where innovations scatter more (or less) than the floor says, best first."""
    if kind.target == "ring" and kind.id in LEVELS:
        return []  # all places share one size: `level_candidates`
    if kind.colour == "walk" and not kind.rare:
        return walking_candidates(bench, kind)
    patterns = kind.patterns(bench.record.layout)
    if not patterns.shape[1]:
        return []
    found = [*_steady(bench, kind, patterns)]
    if kind.lag and not bench.told_floor and (whole := colour_of_all(bench, kind)) is not None:
        found.append(whole)
    if kind.rare:
        found += switching_candidates(bench, kind)
    if kind.sudden and kind.lag == 0:
        found += [*_sudden(bench, kind, patterns)]
    return sorted(found, key=lambda c: c.gain - np.log(c.choices), reverse=True)[:_KEPT]


def beyond_healthy(gain: Vector, ratio: Vector, scatter: float | Vector = WITHIN) -> Vector:
    """Judge a change of a variance against the wandering of healthy levels too.

    Args:
        gain: Of the changes, less what the choice of their rows costs [nats]: a healthy change
            would have to come at the same row.
        ratio: Variance after over variance before.
        scatter: Of its logarithm, between healthy ones.

    Returns:
        What is beyond healthy changes [nats], at least 0.
    """
    gain = np.maximum(gain, 0.0)
    return held_to(gain, np.log(ratio) / scatter)


def projections(bench: Bench, patterns: Matrix) -> tuple[Matrix, Vector]:
    """bᵀ g of every row and pattern (N, P), and a = bᵀ S⁻¹ b of every pattern (P,)."""
    deviation = np.sqrt(bench.floor.innovation_variance)
    modal = (bench.floor.modes.directions.T @ patterns) / deviation[:, None]
    return bench.white @ modal, np.sum(modal**2, axis=0)


def _per_row(over: Vector) -> Vector:
    """Gain of a row by a variance of its own, from the logarithm of its ratio to the floor's."""
    return 0.5 * (np.expm1(over) - over)


@dataclass(frozen=True, slots=True, eq=False)
class _Scatter:
    """How far every place is from the others.

    Args:
        seen: Correlation, or logarithm of the variance, less that of the usual place, (P,).
        over: The same less what the floor has of it, (P,).
        strength: κ beyond the floor, (P,).
        chance: Standard deviation of `seen` by chance.
        deviation: By chance and by what healthy places differ.
    """

    seen: Vector
    over: Vector
    strength: Vector
    chance: float
    deviation: float


def _scattered(bench: Bench, kind: NoiseKind, patterns: Matrix) -> _Scatter:
    course, size = projections(bench, patterns)
    rows, healthy = len(course), 0.0
    if kind.lag:
        moved = np.sum(course[kind.lag :] * course[: -kind.lag], axis=0) / rows
        over = moved / np.maximum(np.mean(course**2, axis=0), 1e-300)
        chance, strength = 1.0 / np.sqrt(rows), moved / size**2
    else:
        ratio = np.mean(course**2, axis=0) / size
        over = np.log(np.maximum(ratio, 1e-6))
        chance, strength = np.sqrt(2.0 / rows), (ratio - 1.0) / size
    over = over - (np.median(over) if len(over) > _MANY else 0.0)
    seen = over
    if kind.relative and not bench.told_floor:  # a reference knows each BPM by itself
        seen = over + bench.floor.modes.levels
        seen = seen - (np.median(seen) if len(seen) > _MANY else 0.0)
        healthy = bench.floor.modes.scatter
    least = LEAST_COLOUR if kind.lag else _LEAST_SCATTER
    if kind.target == "bpm":  # healthy levels differ BPM by BPM: what a crate has in common less
        least /= float(np.sqrt(np.median(np.count_nonzero(patterns, axis=0))))
    scatter = max(_scatter(over, chance, least), healthy)
    return _Scatter(seen, over, strength, chance, float(np.hypot(chance, scatter)))


def _steady(bench: Bench, kind: NoiseKind, patterns: Matrix) -> Iterator[Candidate]:
    its = _scattered(bench, kind, patterns)
    rows = len(bench.record)
    for members, name, choices in _sets(bench, kind, its.seen, its.deviation):
        # Healthy devices scatter each for itself: what a group has in common shows the better.
        typical, over = float(np.mean(its.seen[members])), float(np.mean(its.over[members]))
        gain = 0.5 * len(members) * (typical / its.deviation) ** 2
        alone = 0.5 * len(members) * (over / its.chance) ** 2
        if not kind.lag:  # a variance that is no little off: the lemma above
            alone = len(members) * rows * float(_per_row(np.array(over)))
        reading = usual_reading(bench, kind, members)
        values = values_of(kind, float(np.mean(its.strength[members])), reading)
        if values is not None:
            places = tuple(int(i) for i in members)
            yield Candidate(Cause(kind, places, values), gain, choices, name, alone)


def _sets(
    bench: Bench, kind: NoiseKind, seen: Vector, deviation: float
) -> Iterator[tuple[Indices, str, float]]:
    """The most conspicuous places, and groups of BPMs; with their names, and out of how many."""
    for place in np.argsort(np.abs(seen))[::-1][:_KEPT]:
        yield np.array([place]), "", float(len(seen))
    bpms = bench.record.layout.bpms
    if not (kind.collective and kind.target == "bpm" and len(seen) == len(bpms)):
        return
    for members in (np.flatnonzero(seen * sign > _STRIKING * deviation) for sign in (1.0, -1.0)):
        if 2 <= len(members) <= _MANY_STRIKE * len(seen):
            yield members, "", float(comb(len(seen), len(members)))
    groups = crates(bench.record.layout.bpms)
    weight = [
        0.5 * float(np.sum(seen[its.members]) / deviation) ** 2 / len(its.members)
        - float(np.log(its.choices))
        for its in groups
    ]
    for index in np.argsort(weight)[::-1][:_KEPT]:
        its = groups[int(index)]
        yield its.members, its.name, its.choices


def _scatter(values: Vector, chance: float, least: float) -> float:
    """Scatter between places beyond chance: no device is exactly like the others."""
    if len(values) < _MANY:
        return 3 * least
    spread = 1.4826 * float(np.median(np.abs(values - np.median(values))))
    return max(least, float(np.sqrt(max(spread**2 - chance**2, 0.0))))


def _sudden(bench: Bench, kind: NoiseKind, patterns: Matrix) -> Iterator[Candidate]:
    """A variance that changes at some row: judged against the record's own quiet part."""
    course, size = projections(bench, patterns)
    squares = course**2 / size
    rows, gain, early, late = parted(squares)
    height = beyond_healthy(gain - np.log(len(squares)), late / early)
    for place in np.argsort(height)[::-1][:_KEPT]:
        reading = usual_reading(bench, kind, np.array([place]))
        strength = float((late[place] - early[place]) / size[place])
        values = values_of(kind, strength, reading)
        if values is not None:
            yield Candidate(
                Cause(kind, (int(place),), values, int(rows[place])),
                float(height[place]),
                float(len(height)),
            )
    if kind.collective and kind.target == "bpm" and (groups := crates(bench.record.layout.bpms)):
        yield from _sudden_crates(bench, kind, squares, size, groups)


def _sudden_crates(
    bench: Bench,
    kind: NoiseKind,
    squares: Matrix,
    size: Vector,
    groups: Sequence[Group],
) -> Iterator[Candidate]:
    """The same of BPMs together, each beside its own mean."""
    usual = np.maximum(squares.mean(axis=0), 1e-300)
    member = membership(groups, squares.shape[1])
    count = member.sum(axis=1)
    together = (member / count[:, None]).T
    parts = [slice(first, first + _AT_ONCE) for first in range(0, len(groups), _AT_ONCE)]
    found = [parted((squares / usual) @ together[:, own], count[own]) for own in parts]
    rows, gain, early, late = (np.concatenate(its) for its in zip(*found, strict=True))
    apart = WITHIN * np.hypot(1.0 / np.sqrt(count), _IN_COMMON)
    height = beyond_healthy(gain - np.log(len(squares)), late / early, apart)
    choices = np.array([group.choices for group in groups])
    for index in np.argsort(height - np.log(choices))[::-1][:_KEPT]:
        name, members, its = groups[int(index)]
        added = float(late[index] - early[index]) * float(np.mean(usual[members] / size[members]))
        values = values_of(kind, added, usual_reading(bench, kind, members))
        if values is not None:
            cause = Cause(kind, tuple(members.tolist()), values, int(rows[index]))
            yield Candidate(cause, float(height[index]), its, name)


def parted(squares: Matrix, count: Vector | float = 1.0) -> tuple[Indices, Vector, Vector, Vector]:
    """Find the row that parts every course of squares best into two of a variance each.

    Squares that scatter more within the parts than those of normal noise do tell less of its
    variance, by as much.

    Args:
        squares: Of white noise, or means of several, shape (N, P).
        count: Of how many each is the mean, shape (P,).

    Returns:
        First row of the later part, gain of all together over one variance for all rows [nats],
        and the variances before and after, each of shape (P,).
    """
    before = np.cumsum(squares, axis=0)
    rows = np.arange(1, len(squares) + 1)[:, None]
    total, length = before[-1], float(len(squares))
    early = np.maximum(before / rows, 1e-9)
    left = np.maximum(length - rows, 1)
    late = np.maximum((total - before) / left, 1e-9)
    gain = -0.5 * (rows * np.log(early) + left * np.log(late) - length * np.log(total / length))
    gain[:EDGE] = 0.0
    gain[-EDGE:] = 0.0
    best = np.argmax(gain, axis=0)
    every = np.arange(gain.shape[1])
    means = early[best, every], late[best, every]
    apart = squares - np.where(rows <= best + 1, *means)
    normal = (best + 1) * means[0] ** 2 + (length - best - 1) * means[1] ** 2
    heavy = 0.5 * count * np.sum(apart**2, axis=0) / normal
    return best + 1, count * gain[best, every] / np.maximum(heavy, 1.0), *means


def values_of(kind: NoiseKind, variance: float, reading: float) -> Values | None:
    """Parameters that belong to κ; None where the effect cannot be of that sign.

    Args:
        kind: Of noise.
        variance: κ.
        reading: Variance of the floor's reading noise [m²].
    """
    size = kind.size(variance, float(np.sqrt(reading)))
    first = kind.parameters[0]
    if not np.isfinite(size) or not first.low <= size <= first.high:
        return None
    return {p.name: p.typical for p in kind.parameters} | {first.name: size}
