"""Effects that strike single ticks at random: how likely each is to be in a record.

A strike z d at one tick has the score λ·d and the information dᵀ W d, so its likelihood ratio is
known tick by tick for a z that is one, or is normal.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.special import expit, logit

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.device_groups import crates, each_alone, groups_of, membership
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.effects.kinds import Values
from orbitfb.effects.random_kinds import LatentKind
from orbitfb.physics.optics import Matrix
from orbitfb.records.record import Record

_RARE = np.geomspace(0.0005, 0.5, 25)
_LEAST_SPIKE = 2.0
"""Spikes are larger than this many standard deviations; what is smaller is plain noise."""
_MOST_SPIKES = 0.05
_SOME = 0.03
"""Probability by which crates are compared."""
_SOMEWHAT = np.array([0.1, 0.3, 1.0])
"""Sizes by which they are, where there is another one at every tick: of one that is just seen."""
_CRATE = 40
"""Devices that share a crate, at most."""
_KEPT = 3


def latent_gain(
    bench: Bench, kind: LatentKind, values: Values, places: Sequence[int] = ()
) -> Vector:
    """Log-likelihood ratio of an effect that strikes at random, by row, shape (N,) [nats].

    Args:
        bench: The record under the causes so far.
        kind: The effect.
        values: All parameters.
        places: That it strikes; all when there are none.
    """
    score, info = strikes(bench, kind, places)
    if kind.per_bpm and len(places):
        score, info = score[:, list(places)], info[:, list(places)]
    return _ratio(kind, score, info, [values[p.name] for p in kind.parameters])


def latent_odds(
    bench: Bench, kind: LatentKind, values: Values, places: Sequence[int] = ()
) -> Matrix:
    """Probability that a row (or a reading) was struck, shape (N, 1) or (N, n)."""
    score, info = strikes(bench, kind, places)
    first, last = values[kind.parameters[0].name], values[kind.parameters[-1].name]
    if kind.strength == "always one":
        ratio = score - 0.5 * info
    else:
        size = last**2
        ratio = normal_ratio(score, info, size)
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
    found = [] if best is None else [best]
    return found + (list(_crates(bench, kind)) if kind.target in ("bpm", "corrector") else [])


def _crates(bench: Bench, kind: LatentKind) -> Iterator[Candidate]:
    """Correctors or BPMs that are struck together: crates, and each corrector by itself.

    What BPMs do each by itself is their noise: a crate has to gain more than that.
    """
    layout = bench.record.layout
    devices = layout.correctors if kind.target == "corrector" else layout.bpms
    groups = [its for its in crates(devices) if len(its.members) <= _CRATE]
    moves, pulls, known = _alone(bench, kind)
    apart = np.zeros(len(devices))
    if kind.target == "corrector":
        groups += each_alone(len(devices))
    else:
        apart = _noisier(pulls, moves**2 * np.diagonal(known))
    heights = np.zeros(len(groups))
    for index, (_, columns, choices) in enumerate(groups):
        own = moves[:, columns]
        score = pulls[:, columns].sum(axis=1, keepdims=True)
        info = np.sum((own @ known[np.ix_(columns, columns)]) * own, axis=1, keepdims=True)
        tried = [_SOME] if kind.strength == "always one" else _SOMEWHAT * _typical(info)
        best = max(float(np.sum(_ratio(kind, score, info, [number]))) for number in tried)
        heights[index] = best - apart[columns].sum() - np.log(choices)
    for index in np.argsort(heights)[::-1][:_KEPT]:
        name, columns, choices = groups[int(index)]
        places = tuple(int(column) for column in columns)
        score, info = strikes(bench, kind, places)
        grid = list(_latent_grid(kind, score, info))
        if not grid:  # what would just be seen is beyond what the effect can be
            continue
        gains = [float(np.sum(_ratio(kind, score, info, [*its.values()]))) for its in grid]
        best = int(np.argmax(gains))
        if (gain := gains[best] - float(apart[columns].sum())) > 0.0:
            cause = Cause(kind, places, grid[best])
            yield Candidate(cause, gain, 10.0 * choices, name)


def _alone(bench: Bench, kind: LatentKind) -> tuple[Matrix, Matrix, Matrix]:
    """What a strike moves of every device, its score, and the information on unit moves.

    Returns:
        Shapes (N, k), (N, k) and (k, k).
    """
    record, floor = bench.record, bench.floor
    if kind.target == "corrector":
        moves = kind.moves(record, bench.currents)
        modal = floor.to_modes(record.layout.response.T)
        pulls = (bench.slope @ record.layout.response) * moves
    else:
        moves = _spoken(record, kind.shapes(record, bench.currents, bench.orbit))
        modal, pulls = floor.modes.directions, bench.slope * moves
    return moves, pulls, (modal * _echo(floor)) @ modal.T


def _spoken(record: Record, shapes: Matrix) -> Matrix:
    """Shapes where readings speak: neither what was filled in does, nor the step after it."""
    filled = record.filled.copy()
    filled[1:] |= record.filled[:-1]
    return np.where(filled, 0.0, shapes)


def shapes_at(bench: Bench, kind: LatentKind, places: Sequence[int] = ()) -> Matrix:
    """Change of the prediction by a strike of strength one at some places, shape (N, n) [m].

    Args:
        bench: The record under the causes so far.
        kind: The effect.
        places: That it strikes together; all when there are none, or where it strikes one by one.
    """
    record, own = bench.record, list(places)
    if own and kind.target == "corrector":
        moves = kind.moves(record, bench.currents)[:, own]
        return moves @ record.layout.response[:, own].T
    shapes = kind.shapes(record, bench.currents, bench.orbit)
    if own and kind.target == "bpm" and not kind.per_bpm:
        struck = np.zeros(shapes.shape[1])
        struck[own] = 1.0
        shapes = shapes * struck
    return shapes


def _latent_places(bench: Bench, kind: LatentKind, score: Matrix, info: Matrix) -> list[Candidate]:
    """Best parameters of every BPM, of every run of cells and of all."""
    bpms = bench.record.layout.bpms
    groups = groups_of(bpms)
    prices = np.log([group.choices for group in groups])
    member = membership(groups, len(bpms))
    found: dict[tuple[int, ...], Candidate] = {}
    noisier = _noisier(score, info)
    for values in _latent_grid(kind, score, info):
        gain = _each_ratio(kind, score, info, list(values.values())).sum(axis=0) - noisier
        together = member @ gain
        tried: list[tuple[tuple[int, ...], float, float, str]] = [
            ((int(i),), float(gain[i]), float(len(gain)), "") for i in np.argsort(gain)[-_KEPT:]
        ]
        for index in np.argsort(together - prices)[-_KEPT:]:
            name, columns, choices = groups[int(index)]
            places = tuple(int(i) for i in columns)
            tried.append((places, float(together[index]), choices, name))
        for places, its, choices, name in tried:
            if its > (found[places].gain if places in found else 0.0):
                found[places] = Candidate(Cause(kind, places, values), its, 10.0 * choices, name)
    return sorted(found.values(), key=lambda c: c.gain - np.log(c.choices), reverse=True)[:_KEPT]


def _noisier(score: Matrix, info: Matrix) -> Vector:
    """Gain of every BPM if its readings were noisier all the time, each by itself, shape (n,)."""
    sizes = _typical(info) * np.geomspace(0.02, 10.0, 24)
    gains = [normal_ratio(score, info, size**2).sum(axis=0) for size in sizes]
    return np.maximum(np.max(gains, axis=0), 0.0)


def strikes(bench: Bench, kind: LatentKind, places: Sequence[int] = ()) -> tuple[Matrix, Matrix]:
    """Score and information of a strike of strength one, (N, 1) or per BPM (N, n)."""
    floor = bench.floor
    echo = _echo(floor)
    shapes = _spoken(bench.record, shapes_at(bench, kind, places))
    score = bench.slope * shapes
    if kind.per_bpm:
        return score, shapes**2 * (floor.modes.directions**2 @ echo)
    info = (floor.to_modes(shapes) ** 2) @ echo
    return score.sum(axis=1, keepdims=True), info[:, None]


def _echo(floor: NoiseFloor) -> Vector:
    """Information on a change of one row, mode by mode, shape (n,) [1/m²].

    It is an innovation now and, less the gain, in the rows after.
    """
    return (1.0 + floor.gains / (2.0 - floor.gains)) / floor.innovation_variance


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
    struck = normal_ratio(score, info, size)
    if kind.strength == "normal":
        return struck
    return np.logaddexp(np.log1p(-numbers[0]), np.log(numbers[0]) + struck)


def normal_ratio(score: Matrix, info: Matrix, variance: float) -> Matrix:
    """Give the log-likelihood ratio of strikes of a normal strength [nats].

    Args:
        score: Of a strike of strength one, of any shape.
        info: Information on it, of that shape.
        variance: Of the strength.
    """
    return 0.5 * variance * score**2 / (1.0 + variance * info) - 0.5 * np.log1p(variance * info)
