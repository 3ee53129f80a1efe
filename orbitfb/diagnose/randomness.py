"""Effects without a course in time: noise that is larger, shared or coloured.

With g = S⁻¹ e, adding κ b bᵀ to the covariance of the innovations changes the log-likelihood by
−½ N log(1 + κ a) + ½ κ / (1 + κ a) Σ (bᵀ g)², a = bᵀ S⁻¹ b (matrix determinant lemma), which is
largest where 1 + κ a is the mean of (bᵀ g)² / a.
"""

from collections.abc import Iterator, Sequence
from math import comb

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.scan import groups_of
from orbitfb.diagnose.switching import switching_candidates
from orbitfb.diagnose.wandering import Wandering
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.random_kinds import NoiseKind
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

_LEAST_SCATTER = 0.05
"""Relative scatter of a healthy variance between devices, beyond chance."""
_LEAST_COLOUR = 0.02
"""The same of a correlation in time: levels of healthy noise differ, but all of it is white."""
_LEVELS = ("noise-level", "ground-motion-level")
"""Kinds that may strike every place alike."""
_LEVEL_SCATTER = 0.1
"""Scatter of the logarithm of a healthy level between times of a record, or records."""
_AS_GOOD = 5.0
"""Gains that differ by less say nothing of which level it is [nats]."""
_KEPT = 3
_MANY = 8
"""Places from which on a typical one can be told."""
_EDGE = 60
_STRIKING = 5.0
"""Standard deviations from which a place is struck for itself, wherever the others stand."""
_MANY_STRIKE = 0.25
"""Share of all places beyond which they are no exceptions."""


def noise_candidates(bench: Bench, kind: NoiseKind) -> list[Candidate]:
    """Find where innovations scatter more (or less) than the floor says, best first."""
    if kind.target == "ring" and kind.id in _LEVELS:
        return []  # all places share one size: `level_candidates`
    patterns = kind.patterns(bench.record.layout)
    if not patterns.shape[1]:
        return []
    if wanders(bench, kind):
        found = _wandering(bench, kind, patterns[:, 0])
        if found is not None:
            return found
    found = [*_steady(bench, kind, patterns)]
    if kind.rare:
        found += switching_candidates(bench, kind)
    if kind.sudden and kind.lag == 0:
        found += [*_sudden(bench, kind, patterns)]
    return sorted(found, key=lambda c: c.gain - np.log(c.choices), reverse=True)[:_KEPT]


def wanders(bench: Bench, kind: NoiseKind) -> bool:
    """Whether an effect is one shape that walks, and the floor may have taken it over."""
    return kind.colour == "walk" and kind.target == "ring" and not bench.told_floor


def _wandering(bench: Bench, kind: NoiseKind, shape: Vector) -> list[Candidate] | None:
    """Try a shape that walks in a few modes; None when it has too many."""
    walk = Wandering(bench, shape)
    if not walk.seen:
        return None
    variance, gain = walk.best()
    values = _values(kind, variance, float(np.sqrt(bench.floor.reading)))
    if values is None or gain <= 0.0:
        return []
    return [Candidate(Cause(kind, (0,), values), gain, 1.0)]


def level_candidates(bench: Bench, kinds: Sequence[EffectKind]) -> list[Candidate]:
    """Try another level of all the reading noise, or of all the walk, from some row on.

    What a level explains best decides between them; how far it is from healthy ones only says how
    sure it is.

    Args:
        bench: The record under the causes accepted so far.
        kinds: Those that the record can show.
    """
    levels = [kind for kind in kinds if isinstance(kind, NoiseKind) and kind.id in _LEVELS]
    found = [one for kind in levels if (one := _level(bench, kind)) is not None]
    best = max((gain for gain, _ in found), default=0.0)
    return [candidate for gain, candidate in found if gain > best - _AS_GOOD]


def _level(bench: Bench, kind: NoiseKind) -> tuple[float, Candidate] | None:
    """Another level of one noise: its gain, and the candidate that it makes.

    The variance of a mode's innovation goes with q as its share L / (2 − L), and with r² as the
    rest. Without a reference the level of the whole record is what the floor was fitted to; a
    change within it is judged against the record's own other part.
    """
    record = bench.record
    share = bench.floor.gains / (2.0 - bench.floor.gains)
    share = share if kind.colour == "walk" else 1.0 - share
    squares = bench.white**2
    factors = np.exp(np.linspace(-3.0, 5.0, 41))
    by_row = np.empty((len(factors), len(squares)))
    for index, factor in enumerate(factors):
        more = (factor - 1.0) * share
        by_row[index] = -0.5 * np.sum(np.log1p(more)) + 0.5 * squares @ (more / (1.0 + more))
    by_row[:, record.starts] = 0.0
    before = np.cumsum(by_row, axis=1)
    whole = before[:, -1]
    if bench.told_floor:
        row, late = 0, int(np.argmax(whole))
        gain, ratio, choices = float(whole[late]), float(factors[late]), 1.0
    else:
        after = whole[:, None] - before
        steps = before.max(axis=0) + after.max(axis=0) - float(whole.max())
        steps[:_EDGE] = 0.0
        steps[-_EDGE:] = 0.0
        row = int(np.argmax(steps))
        gain, choices = float(steps[row]), float(len(steps))
        early, late = int(np.argmax(before[:, row])), int(np.argmax(after[:, row]))
        ratio = float(factors[late] / factors[early])
    sure = float(_beyond_healthy(np.array([gain]), np.array([ratio]))[0])
    places: tuple[int, ...] = () if kind.target == "ring" else tuple(range(len(record.layout.bpms)))
    values = {p.name: p.typical for p in kind.parameters}
    values[kind.parameters[0].name] = float(np.sqrt(ratio))
    cause = Cause(kind, places, values, row + 1 if row else 0)
    return (gain, Candidate(cause, sure, choices, "all", gain)) if sure > 0 else None


def _beyond_healthy(gain: Vector, ratio: Vector) -> Vector:
    """Judge a change of a variance against the wandering of healthy levels too.

    Args:
        gain: Of the changes, at least 0 [nats].
        ratio: Variance after over variance before.
    """
    tolerance = 0.5 * (np.log(ratio) / _LEVEL_SCATTER) ** 2
    return gain * tolerance / np.maximum(gain + tolerance, 1e-300)


def projections(bench: Bench, patterns: Matrix) -> tuple[Matrix, Vector]:
    """bᵀ g of every row and pattern (N, P), and a = bᵀ S⁻¹ b of every pattern (P,)."""
    deviation = np.sqrt(bench.floor.innovation_variance)
    modal = (bench.floor.modes.T @ patterns) / deviation[:, None]
    return bench.white @ modal, np.sum(modal**2, axis=0)


def level_spares(bench: Bench, kind: NoiseKind) -> Vector:
    """Give what another level of the noise of each place is worth beyond what counts [nats].

    Healthy devices scatter: so much of the gain of whatever changes the level is no evidence.

    Args:
        bench: The record under the causes accepted so far.
        kind: The level of the noise.

    Returns:
        Shape (places,), at least 0.
    """
    seen, _, _, deviation = _scattered(bench, kind, kind.patterns(bench.record.layout))
    alone = len(bench.record) * _per_row(seen)
    return np.maximum(alone - 0.5 * (seen / deviation) ** 2, 0.0)


def _per_row(seen: Vector) -> Vector:
    """Gain of a row by a variance of its own, from the logarithm of its ratio to the floor's."""
    return 0.5 * (np.expm1(seen) - seen)


def _scattered(
    bench: Bench, kind: NoiseKind, patterns: Matrix
) -> tuple[Vector, Vector, float, float]:
    """How far every place is from the others, by how much, by chance, and healthy ones too."""
    course, size = projections(bench, patterns)
    rows = len(course)
    if kind.lag:
        moved = np.sum(course[kind.lag :] * course[: -kind.lag], axis=0) / rows
        seen = moved / np.maximum(np.mean(course**2, axis=0), 1e-300)
        chance, strength = 1.0 / np.sqrt(rows), moved / size**2
    else:
        ratio = np.mean(course**2, axis=0) / size
        seen = np.log(np.maximum(ratio, 1e-6))
        chance, strength = np.sqrt(2.0 / rows), (ratio - 1.0) / size
    seen = seen - (np.median(seen) if len(seen) > _MANY else 0.0)
    least = _LEAST_COLOUR if kind.lag else _LEAST_SCATTER
    return seen, strength, chance, float(np.hypot(chance, _scatter(seen, chance, least)))


def _steady(bench: Bench, kind: NoiseKind, patterns: Matrix) -> Iterator[Candidate]:
    seen, strength, chance, deviation = _scattered(bench, kind, patterns)
    rows = len(bench.record)
    reading = float(np.sqrt(bench.floor.reading))
    for members, name, choices in _sets(bench, kind, seen, deviation):
        # Healthy devices scatter each for itself: what a group has in common shows the better.
        typical = float(np.mean(seen[members]))
        gain = 0.5 * len(members) * (typical / deviation) ** 2
        alone = 0.5 * len(members) * (typical / chance) ** 2
        if not kind.lag:  # a variance that is no little off: the lemma above
            alone = len(members) * rows * float(_per_row(np.array(typical)))
        values = _values(kind, float(np.mean(strength[members])), reading)
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
    # All of them are what the floor is made of.
    groups = [
        (name, members)
        for name, members in groups_of(bpms.groups(), len(bpms), bpms.planes)
        if 2 * len(members) <= len(bpms)
    ]
    if not groups:
        return
    weight = [abs(float(np.sum(seen[members]))) / np.sqrt(len(members)) for _, members in groups]
    for index in np.argsort(weight)[::-1][:_KEPT]:
        name, members = groups[int(index)]
        yield members, name, float(len(groups))


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
    before = np.cumsum(squares, axis=0)
    rows = np.arange(1, len(squares) + 1)[:, None]
    total, count = before[-1], float(len(squares))
    early = np.maximum(before / rows, 1e-9)
    left = np.maximum(count - rows, 1)
    late = np.maximum((total - before) / left, 1e-9)
    gain = -0.5 * (rows * np.log(early) + left * np.log(late) - count * np.log(total / count))
    gain[:_EDGE] = 0.0
    gain[-_EDGE:] = 0.0
    best = np.argmax(gain, axis=0)
    every = np.arange(gain.shape[1])
    height = _beyond_healthy(gain[best, every], (late / early)[best, every])
    reading = float(np.sqrt(bench.floor.reading))
    for place in np.argsort(height)[::-1][:_KEPT]:
        row = int(best[place])
        strength = float((late[row, place] - early[row, place]) / size[place])
        values = _values(kind, strength, reading)
        if values is not None:
            yield Candidate(
                Cause(kind, (int(place),), values, row + 1), float(height[place]), float(gain.size)
            )


def _values(kind: NoiseKind, variance: float, reading: float) -> Values | None:
    """Parameters that belong to κ; None where the effect cannot be of that sign."""
    size = kind.size(variance, reading)
    first = kind.parameters[0]
    if not np.isfinite(size) or not first.low <= size <= first.high:
        return None
    return {p.name: p.typical for p in kind.parameters} | {first.name: size}
