"""Laws whose amplitude is random: walks, common noise, strokes that are rare."""

from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.lines import strongest_line
from orbitfb.diagnose.hypotheses.noise.colour import scan_colour
from orbitfb.diagnose.hypotheses.noise.levels import scan_ground_level, scan_level
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.corrected import over
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import RandomLaw
from orbitfb.estimation.moments import Moments, weighed_sums
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.priors import (
    KNOWN_TO,
    MORE,
    RANDOM_VARIANCES,
    STROKE_PLACES,
    STROKES,
    UNSURE,
    VALUE_COST,
)
from orbitfb.estimation.transform import Matrix, StepTransform


@dataclass(frozen=True, slots=True, eq=False)
class _Weighed:
    """Patterns beside a floor that has no free part: only the shapes that ground may have."""

    noise: StepNoise
    pulled: Matrix
    late: Matrix


def scan_random(kind: EffectKind, law: RandomLaw, scorer: Scorer) -> list[Candidate]:
    """Find the place whose random amplitude has the most evidence."""
    if law.relative:
        return scan_level(kind, law, scorer)
    if law.lag:
        return scan_colour(kind, law, scorer)
    if law.together and law.patterns.shape[1] != 1:
        return scan_ground_level(kind, law, scorer)
    space = scorer.space
    noise = replace(space.noise, walk=space.shape + space.held)
    mean = space.errors.mean()
    left = space.residual - space.terms.contribution(mean)
    pulled = noise.pull(left, space.transform)
    weighed = _Weighed(noise, pulled, space.transform.turn(pulled))
    steady = _steady(kind, law, space, weighed)
    if not law.walk or law.smooth:
        return [steady]
    found = [steady, *_strokes(kind, law, scorer)]
    if law.together:
        line = strongest_line(scorer, law.patterns, shaped=False)
        size = float(np.hypot(line.cosine, line.sine)) * 2.0 * np.sin(np.pi * line.cycles)
        values = {p.name: p.typical for p in kind.parameters}
        values[kind.parameters[0].name] = size / np.sqrt(2.0)
        found.append(Candidate(kind, (), (), values, line.evidence, field=line.field))
    return found


def _steady(kind: EffectKind, law: RandomLaw, space: Workspace, weighed: _Weighed) -> Candidate:
    """Amplitudes that are normal at every row."""
    transform, noise = space.transform, weighed.noise
    seen = (law.patterns.T @ noise.modes) ** 2
    weights = (1.0 / noise.variance(transform)) @ seen.T
    count = transform.count[:, None].astype(float)
    precision = transform.by_band(weights) / count
    normal = (weighed.pulled @ law.patterns) ** 2 / weights
    by_band = transform.by_band(normal) * precision
    eigenvalue = (np.bincount(transform.band, transform.eigenvalue) / transform.count)[:, None]
    power = -1.0 if law.smooth else 0.0 if law.walk else 1.0
    weight = eigenvalue**power
    scale = np.sum(count * precision * weight, axis=0) / count.sum()
    best, size = np.zeros(law.patterns.shape[1]), np.zeros(law.patterns.shape[1])

    def gained(variance: Matrix) -> Vector:
        grown = 1.0 + variance * precision
        return np.asarray(
            np.sum(-0.5 * count * np.log(grown) + 0.5 * variance * by_band / grown, axis=0)
        )

    for factor in RANDOM_VARIANCES:
        gain = gained(factor / np.maximum(scale, 1e-300) * weight)
        better = gain > best
        best[better], size[better] = gain[better], (factor / scale)[better]
    # What the ground may do along the pattern, too, is no effect.
    usual = _unsure(law.patterns, space, precision)
    best = best - np.max([gained(share * usual[None, :]) for share in UNSURE], axis=0)
    place = int(np.argmax(best))
    gain = float(best[place]) - np.log(len(best)) - VALUE_COST
    found = _candidate(kind, law, space, place, float(size[place]), gain)
    if not law.smooth:
        return found
    variance = (float(size[place]) * weight[:, 0])[transform.band]
    choice = float(np.log(len(best))) + VALUE_COST
    whole = replace(found, walk=None)
    return _coursed(whole, law.patterns[:, place], variance, weighed.pulled, noise, space, choice)


def _coursed(
    one: Candidate,
    pattern: Vector,
    variance: Vector,
    pulled: Matrix,
    noise: StepNoise,
    space: Workspace,
    choice: float,
) -> Candidate:
    """Give a candidate the most likely course of its place, and what the course costs.

    Args:
        one: The candidate.
        pattern: Of its place, shape (n,) [m].
        variance: Of its amplitude at every frequency, shape (T,).
        pulled: Ω z without it, shape (T, n) [1/m].
        noise: The floor that Ω is of.
        space: The record.
        choice: Cost of its place and values [nats].
    """
    transform = space.transform
    own = (1.0 / noise.variance(transform)) @ ((pattern @ noise.modes) ** 2)
    course = variance * (pulled @ pattern) / (1.0 + variance * own)
    field = np.outer(course, pattern)
    apart = np.divide(course**2, variance, out=np.zeros_like(course), where=variance > 0.0)
    cost = 0.5 * float(np.sum(apart + np.log1p(variance * own))) + choice
    swing = float(np.ptp(transform.summed(course[:, None])))

    def again(after: Workspace) -> Candidate:
        left = after.residual + field - after.terms.contribution(after.errors.mean())
        fresh = after.noise.pull(left, transform)
        return _coursed(one, pattern, variance, fresh, after.noise, after, choice)

    values = {**one.values, one.kind.parameters[0].name: swing}
    return replace(one, values=values, field=field, cost=cost, again=again)


def _unsure(patterns: Matrix, space: Workspace, precision: Matrix) -> Vector:
    """Walk along patterns by which that of the ground may be wrong, shape (D,).

    That is a factor of two of what the ground's shapes leave there, or the standard error of a
    variance that is told by as many steps as the shapes are worth: patterns that few quadrupoles
    move share the errors of others.

    Args:
        patterns: Shape (n, D).
        space: With the ground.
        precision: Of the patterns in every band, shape (B, D).
    """
    walk, error = space.shape + space.held, float(np.sqrt(2.0 / space.trust))
    length = np.maximum(np.sum(patterns**2, axis=0), 1e-300)
    along = np.einsum("nd,nm,md->d", patterns, walk, patterns, optimize=True) / length**2
    return np.maximum(1.0 / np.maximum(precision.max(axis=0), 1e-300), error * along)


def _strokes(kind: EffectKind, law: RandomLaw, scorer: Scorer) -> list[Candidate]:
    """Amplitudes that come in a few rows only: orthogonal matching pursuit.

    A single one is a jump, which is another effect.

    Y. C. Pati et al., Asilomar Conf. Signals (1993) 40, with the row that is most likely struck
    instead of the largest projection, until none is worth its choice among all rows.
    Few strokes are far above the walk that they are on average, so the floor may have any shape.
    """
    along = scorer.rows.late @ law.patterns
    _, own = _at_places(law.patterns, scorer)
    hopeful = np.argsort(-np.max(along**2, axis=0) / own)[:STROKE_PLACES]
    found = [_struck(kind, law, scorer, place) for place in map(int, hopeful)]
    struck = [one for one in found if one is not None]
    return sorted(struck, key=lambda one: -one.evidence)[:1]


def _at_places(patterns: Matrix, scorer: Scorer) -> tuple[Matrix, Vector]:
    """Information of a step along patterns at every frequency, shape (T, D), and its mean, (D,)."""
    noise = scorer.space.noise
    weights = (1.0 / noise.variance(scorer.space.transform)) @ ((patterns.T @ noise.modes) ** 2).T
    return weights, weights.mean(axis=0)


def _struck(kind: EffectKind, law: RandomLaw, scorer: Scorer, place: int) -> Candidate | None:
    """The strokes at a place; None: they are less than two."""
    space, pattern = scorer.space, law.patterns[:, [place]]
    pull = (scorer.rows.late @ pattern)[:, 0]
    gain, strokes = pursued(pull, _at_places(pattern, scorer)[0][:, 0], space.transform)
    if np.count_nonzero(strokes) < 2:
        return None
    evidence = gain - float(np.log(law.patterns.shape[1])) - VALUE_COST
    whole = _candidate(kind, law, space, place, float(np.mean(strokes**2)), evidence)
    values = {**whole.values, **law.strokes(strokes)}
    known = dict.fromkeys(values, 1.0 / float(np.sqrt(np.count_nonzero(strokes))))
    # Strokes that are hardly worth their choice tell their size no better than it was known.
    shown = max(2.0 * gain, 0.0) + 1.0 / KNOWN_TO**2
    known[kind.parameters[0].name] = 1.0 / float(np.sqrt(shown))
    whole = replace(whole, values=values, deviations=known)
    field = space.transform.turn(strokes[:, None]) @ pattern.T

    def again(after: Workspace) -> Candidate:
        over_it = Scorer.of(over(space, after))
        return _struck(kind, law, over_it, place) or replace(one, evidence=0.0)

    cost = scorer.likelihood(field) - evidence
    one = replace(whole, walk=None, field=field, cost=cost, again=again)
    return one


def pursued(pull: Vector, weights: Vector, transform: StepTransform) -> tuple[float, Vector]:
    """Evidence of strokes at single rows, and the strokes of every row, shape (T,).

    Rows are chosen one after the other, and the sizes of all are told together.

    Args:
        pull: Of a stroke at every step, shape (T,).
        weights: Information of it at every frequency, shape (T,).
        transform: Of the record.
    """
    own, cost = transform.at_rows(weights), float(np.log(len(pull)))
    left, struck = pull.copy(), list[int]()
    basis, information = np.zeros((len(pull), 0)), np.zeros((0, 0))
    sizes = np.zeros(0)
    while len(struck) < STROKES * len(pull):
        row = int(np.argmax(left**2 / own))
        square = float(left[row] ** 2 / own[row])
        if row in struck or 0.5 * square - cost - 0.5 * float(np.log1p(square)) < MORE:
            break
        struck.append(row)
        stroke = np.zeros((len(pull), 1))
        stroke[row] = 1.0
        basis = np.hstack([basis, transform.turn(stroke)])
        information = np.pad(information, (0, 1))
        information[-1] = information[:, -1] = basis.T @ (weights * basis[:, -1])
        sizes = np.linalg.solve(information, pull[struck])
        left = pull - transform.turn((weights * (basis @ sizes))[:, None])[:, 0]
    strokes = np.zeros(len(pull))
    strokes[struck] = sizes
    chosen = len(struck) * cost + 0.5 * float(np.sum(np.log1p(own[struck] * sizes**2)))
    return 0.5 * float(pull @ strokes) - chosen, strokes


def scaled(one: Candidate, factor: float, space: Workspace) -> Candidate:
    """The same random cause with its variance times a factor."""
    part = one.walk if one.walk is not None else one.white
    law = next(law for law in space.courses.laws(one.kind) if isinstance(law, RandomLaw))
    place = one.places[0] if one.places else 0
    pattern = law.patterns[:, place]
    variance = factor * float(np.trace(np.asarray(part)) / (pattern @ pattern))
    return _candidate(one.kind, law, space, place, variance, one.evidence)


def of_variance(one: Candidate, space: Workspace) -> tuple[float, float]:
    """Derivative of the log likelihood by the log of a random cause's variance, and information.

    Args:
        one: Accepted, with a walk or a white part.
        space: With it; its floor stays as it is.
    """
    noise, transform = space.noise, space.transform
    left, scatter = space.unmodelled()
    sums = weighed_sums(noise, Moments.of(left, transform).beside(scatter))
    walk = np.zeros_like(noise.walk) if one.walk is None else one.walk
    white = np.zeros_like(walk) if one.white is None else one.white
    pull, expected, noisy, usual = sums
    score = 0.5 * float(np.sum(walk * (pull - expected)) + np.sum(white * (noisy - usual)))
    parts = [noise.modes.T @ part @ noise.modes for part in (walk, white)]
    information = 0.0
    for inverse, level, count in zip(
        noise.inverse_variance(transform), transform.band_levels(), transform.count, strict=True
    ):
        half = np.sqrt(inverse)
        mixed = half[:, None] * (parts[0] + level * parts[1]) * half
        information += 0.5 * float(count) * float(np.sum(mixed**2))
    return score, information


def _candidate(
    kind: EffectKind, law: RandomLaw, space: Workspace, place: int, variance: float, gain: float
) -> Candidate:
    pattern = law.patterns[:, place]
    reading = float(np.sqrt(np.median(space.noise.reading)))
    values = {p.name: p.typical for p in kind.parameters}
    values[kind.parameters[0].name] = law.size(variance, reading)
    spread = variance * np.outer(pattern, pattern)
    places = () if law.together else (place,)
    names = () if law.together else (law.names[place],)
    if law.walk:
        cost = float(np.log(len(law.names))) + VALUE_COST
        return Candidate(kind, places, names, values, gain, walk=spread, courseless=True, cost=cost)
    return Candidate(kind, places, names, values, gain, white=spread, noisy=True)
