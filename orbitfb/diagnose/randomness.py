"""Effects without a course in time: noise that is larger, shared, coloured, or strikes at random.

With g = S⁻¹ e, adding κ b bᵀ to the covariance of the innovations changes the log-likelihood by
−½ N log(1 + κ a) + ½ κ / (1 + κ a) Σ (bᵀ g)², a = bᵀ S⁻¹ b (matrix determinant lemma), which is
largest where 1 + κ a is the mean of (bᵀ g)² / a. A strike z d at one tick has the score λ·d and
the information dᵀ W d, so its likelihood ratio is known tick by tick for a z that is one, or is
normal.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.special import expit, logit

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.scan import groups_of
from orbitfb.effects.kinds import Values
from orbitfb.effects.random_kinds import LatentKind, NoiseKind
from orbitfb.physics.optics import Matrix

_LEAST_SCATTER = 0.05
"""Relative scatter of a healthy variance between devices, beyond chance."""
_RARE = np.geomspace(0.0005, 0.5, 25)
_LEVELS = ("noise-level", "ground-motion-level")
"""Kinds that may strike every place alike."""
_LEVEL_SCATTER = 0.1
"""Scatter of the logarithm of a healthy level between times of a record, or records."""
_LEAST_SPIKE = 4.0
"""Spikes are larger than this many standard deviations; what is smaller is plain noise."""
_MOST_SPIKES = 0.05
_KEPT = 3
_EDGE = 60


def noise_candidates(bench: Bench, kind: NoiseKind) -> list[Candidate]:
    """Find where innovations scatter more (or less) than the floor says, best first."""
    if kind.target == "ring" and kind.id in _LEVELS:
        return []  # all places share one size: `level_candidates`
    patterns = kind.patterns(bench.record.layout)
    if not patterns.shape[1]:
        return []
    found = [*_steady(bench, kind, patterns)]
    if kind.sudden and kind.lag == 0:
        found += [*_sudden(bench, kind, patterns)]
    return sorted(found, key=lambda c: c.gain - np.log(c.choices), reverse=True)[:_KEPT]


def level_candidates(bench: Bench, kind: NoiseKind) -> list[Candidate]:
    """Try another level of all the reading noise, or of all the walk, from some row on.

    The variance of a mode's innovation goes with q as its share L / (2 − L), and with r² as the
    rest. Without a reference the level of the whole record is what the floor was fitted to; a
    change within it is judged against the record's own other part.
    """
    if kind.id not in _LEVELS:
        return []
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
    # Levels of healthy rings wander: a factor is judged against their usual scatter too.
    tolerance = 0.5 * (np.log(ratio) / _LEVEL_SCATTER) ** 2
    gain = gain * tolerance / (gain + tolerance) if gain + tolerance > 0 else 0.0
    places: tuple[int, ...] = () if kind.target == "ring" else tuple(range(len(record.layout.bpms)))
    values = {p.name: p.typical for p in kind.parameters}
    values[kind.parameters[0].name] = float(np.sqrt(ratio))
    cause = Cause(kind, places, values, row + 1 if row else 0)
    return [Candidate(cause, gain, choices, "all")] if gain > 0 else []


def projections(bench: Bench, patterns: Matrix) -> tuple[Matrix, Vector]:
    """bᵀ g of every row and pattern (N, P), and a = bᵀ S⁻¹ b of every pattern (P,)."""
    deviation = np.sqrt(bench.floor.innovation_variance)
    modal = (bench.floor.modes.T @ patterns) / deviation[:, None]
    return bench.white @ modal, np.sum(modal**2, axis=0)


def _steady(bench: Bench, kind: NoiseKind, patterns: Matrix) -> Iterator[Candidate]:
    course, size = projections(bench, patterns)
    rows = len(course)
    if kind.lag:
        moved = np.sum(course[kind.lag :] * course[: -kind.lag], axis=0) / rows
        ratio = moved / np.maximum(np.mean(course**2, axis=0), 1e-300)
        deviation = np.hypot(1.0 / np.sqrt(rows), _scatter(ratio, 1.0 / np.sqrt(rows)))
        strength, gain = moved / size**2, 0.5 * (ratio / deviation) ** 2
    else:
        ratio = np.mean(course**2, axis=0) / size
        logarithm = np.log(np.maximum(ratio, 1e-6))
        chance = np.sqrt(2.0 / rows)
        deviation = np.hypot(chance, _scatter(logarithm, chance))
        centre = np.median(logarithm) if len(logarithm) > 8 else 0.0
        strength = (ratio - 1.0) / size
        gain = 0.5 * ((logarithm - centre) / deviation) ** 2
    reading = float(np.sqrt(bench.floor.reading))
    for place in np.argsort(gain)[::-1][:_KEPT]:
        values = _values(kind, float(strength[place]), reading)
        if values is not None:
            yield Candidate(Cause(kind, (int(place),), values), float(gain[place]), len(gain))


def _scatter(values: Vector, chance: float) -> float:
    """Scatter between places beyond chance: no device is exactly like the others."""
    if len(values) < 8:
        return 3 * _LEAST_SCATTER
    spread = 1.4826 * float(np.median(np.abs(values - np.median(values))))
    return max(_LEAST_SCATTER, float(np.sqrt(max(spread**2 - chance**2, 0.0))))


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
    height = gain[best, np.arange(gain.shape[1])]
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


def latent_gain(
    bench: Bench, kind: LatentKind, values: Values, places: Sequence[int] = ()
) -> Vector:
    """Log-likelihood ratio of an effect that strikes at random, by row, shape (N,) [nats].

    Args:
        bench: The record under the causes so far.
        kind: The effect.
        values: All parameters.
        places: BPMs that it strikes, if it strikes BPM by BPM; all when there are none.
    """
    score, info = strikes(bench, kind)
    if kind.per_bpm and len(places):
        score, info = score[:, list(places)], info[:, list(places)]
    return _ratio(kind, score, info, [values[p.name] for p in kind.parameters])


def latent_odds(bench: Bench, kind: LatentKind, values: Values) -> Matrix:
    """Probability that a row (or a reading) was struck, shape (N, 1) or (N, n)."""
    score, info = strikes(bench, kind)
    first, last = values[kind.parameters[0].name], values[kind.parameters[-1].name]
    if kind.strength == "always one":
        ratio = score - 0.5 * info
    else:
        size = last**2
        ratio = _normal(score, info, size)
    return expit(ratio + logit(first))


def latent_candidates(bench: Bench, kind: LatentKind) -> list[Candidate]:
    """Find the best parameters, and the BPMs where it strikes BPM by BPM, best first."""
    score, info = strikes(bench, kind)
    if kind.per_bpm:
        return _latent_places(bench, kind, score, info)
    best: Candidate | None = None
    for values in _latent_grid(kind, score, info):
        gain = float(np.sum(_ratio(kind, score, info, list(values.values()))))
        if gain > (0.0 if best is None else best.gain):
            best = Candidate(Cause(kind, (), values), gain, 10.0)
    return [] if best is None else [best]


def _latent_places(bench: Bench, kind: LatentKind, score: Matrix, info: Matrix) -> list[Candidate]:
    """Best parameters of every BPM, of every run of cells and of all."""
    bpms = bench.record.layout.bpms
    groups = list(groups_of(bpms.groups(), len(bpms), bpms.planes))
    member = np.zeros((len(groups), len(bpms)))
    for row, (_, columns) in enumerate(groups):
        member[row, columns] = 1.0
    found: dict[tuple[int, ...], Candidate] = {}
    noisier = _noisier(score, info)
    for values in _latent_grid(kind, score, info):
        gain = _each_ratio(kind, score, info, list(values.values())).sum(axis=0) - noisier
        together = member @ gain
        tried: list[tuple[tuple[int, ...], float, int, str]] = [
            ((int(i),), float(gain[i]), len(gain), "") for i in np.argsort(gain)[-_KEPT:]
        ]
        for index in np.argsort(together)[-_KEPT:]:
            name, columns = groups[int(index)]
            places = tuple(int(i) for i in columns)
            tried.append((places, float(together[index]), len(groups), name))
        for places, its, choices, name in tried:
            if its > (found[places].gain if places in found else 0.0):
                found[places] = Candidate(Cause(kind, places, values), its, 10.0 * choices, name)
    return sorted(found.values(), key=lambda c: c.gain - np.log(c.choices), reverse=True)[:_KEPT]


def _noisier(score: Matrix, info: Matrix) -> Vector:
    """Gain of every BPM if its readings were noisier all the time: that is no rare strike, (n,)."""
    sizes = _typical(info) * np.geomspace(0.02, 10.0, 24)
    gains = [_normal(score, info, size**2).sum(axis=0) for size in sizes]
    return np.maximum(np.max(gains, axis=0), 0.0)


def strikes(bench: Bench, kind: LatentKind) -> tuple[Matrix, Matrix]:
    """Score and information of a strike of strength one, (N, 1) or per BPM (N, n)."""
    shapes = kind.shapes(bench.record, bench.currents, bench.orbit)
    floor = bench.floor
    # A change of one row is an innovation now and, less the gain, in the rows after.
    echo = (1.0 + floor.gains / (2.0 - floor.gains)) / floor.innovation_variance
    score = bench.slope * shapes
    if kind.per_bpm:
        return score, shapes**2 * (floor.modes**2 @ echo)
    info = (floor.to_modes(shapes) ** 2) @ echo
    return score.sum(axis=1, keepdims=True), info[:, None]


def _latent_grid(kind: LatentKind, score: Matrix, info: Matrix) -> Iterator[Values]:
    first = kind.parameters[0]
    if kind.strength == "always one":
        for share in _RARE[(first.low <= _RARE) & (first.high >= _RARE)]:
            yield {first.name: float(share)}
        return
    few = _RARE[_RARE <= _MOST_SPIKES]
    typical = _typical(info)
    sizes = typical * np.geomspace(0.02, 50.0, 30)
    if kind.strength == "normal":
        for size in sizes[(sizes >= first.low) & (sizes <= first.high)]:
            yield {first.name: float(size)}
        return
    second = kind.parameters[1]
    large = typical * np.geomspace(_LEAST_SPIKE, 100.0, 12)
    for share in few[::2]:
        for size in large:
            if first.low <= share <= first.high and second.low <= size <= second.high:
                yield {first.name: float(share), second.name: float(size)}


def _typical(info: Matrix) -> float:
    """Strength of a strike that is just seen."""
    return (
        float(np.sqrt(1.0 / np.maximum(np.median(info[info > 0]), 1e-300))) if info.any() else 1.0
    )


def _ratio(kind: LatentKind, score: Matrix, info: Matrix, numbers: list[float]) -> Vector:
    return _each_ratio(kind, score, info, numbers).sum(axis=1)


def _each_ratio(kind: LatentKind, score: Matrix, info: Matrix, numbers: list[float]) -> Matrix:
    """Log-likelihood ratio of every row, and of every BPM where it strikes BPM by BPM."""
    if kind.strength == "always one":
        share = numbers[0]
        return np.logaddexp(np.log1p(-share), np.log(share) + score - 0.5 * info)
    size = numbers[-1] ** 2
    struck = _normal(score, info, size)
    if kind.strength == "normal":
        return struck
    return np.logaddexp(np.log1p(-numbers[0]), np.log(numbers[0]) + struck)


def _normal(score: Matrix, info: Matrix, variance: float) -> Matrix:
    """Log-likelihood ratio of strikes of normal strength, shape as `score`."""
    return 0.5 * variance * score**2 / (1.0 + variance * info) - 0.5 * np.log1p(variance * info)
