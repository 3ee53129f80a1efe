"""Laws of the reading noise itself: its level in time or with the beam, its memory."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from orbitfb.core.robust import TO_SIGMA
from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import RandomLaw
from orbitfb.estimation.priors import (
    ANYWHERE,
    LEVEL_RATIOS,
    LEVEL_WINDOWS,
    MORE,
    ODD,
    VALUE_COST,
)
from orbitfb.estimation.transform import Matrix


@dataclass(frozen=True, slots=True, eq=False)
class ReadingNoise:
    """The most likely noise of every reading, over its standard deviation.

    Args:
        values: Standardised, shape (T, n).
    """

    values: Matrix

    @classmethod
    def of(cls, scorer: Scorer) -> "ReadingNoise":
        """E[v | record] = N Dᵀ Ω z, D the difference from row to row."""
        space = scorer.space
        transform, noise = space.transform, space.noise
        reading = noise.reading
        late = scorer.rows.late
        following = np.vstack([late[1:], np.zeros_like(late[:1])])
        found = reading * (late - following)
        share = np.mean(transform.eigenvalue[:, None] / noise.variance(transform), axis=0)
        spread = reading**2 * ((noise.modes**2) @ share)
        return cls(found / np.sqrt(spread))


def scan_level(kind: EffectKind, law: RandomLaw, scorer: Scorer) -> list[Candidate]:
    """Find a level of the noise that changes within the record, of all BPMs or of some."""
    noise = ReadingNoise.of(scorer).values
    parts = np.array_split(noise**2, LEVEL_WINDOWS)
    square = np.stack([part.mean(axis=0) for part in parts])
    count = np.array([len(part) for part in parts], dtype=float)[:, None]
    middle = (np.arange(LEVEL_WINDOWS) + 0.5) / LEVEL_WINDOWS
    best: tuple[float, tuple[int, ...], float, int] = (-np.inf, (), 1.0, 0)
    shapes = [(factor, 0, 1.0 + (factor - 1.0) * middle) for factor in LEVEL_RATIOS]
    shapes += [
        (factor, begin, np.where(late, factor, 1.0)) for factor, begin, late in _beginnings()
    ]
    for factor, begin, shape in shapes:
        gain = _level_gain(square, count, shape[:, None] ** 2)
        found, places = _all_or_some(gain)
        if found > best[0]:
            best = (found, places, factor, begin)
    gain, places, factor, begin = best
    rows = scorer.space.transform.step_rows()
    onset = int(rows[sum(len(part) for part in parts[:begin])]) if begin else 0
    names = tuple(law.names[place] for place in places)
    values = {kind.parameters[0].name: float(factor)}
    cost = VALUE_COST + np.log(len(shapes))
    course = Candidate(kind, places, names, values, gain - cost, onset=onset, noisy=True)
    return [course, *_odd_level(kind, law, scorer)]


def _beginnings() -> Iterator[tuple[float, int, Mask]]:
    """Ratios of levels, the window from which a level is another one, and which windows are."""
    for factor in LEVEL_RATIOS:
        for begin in range(2, LEVEL_WINDOWS - 1, 2):
            yield factor, begin, np.arange(LEVEL_WINDOWS) >= begin


def scan_ground_level(kind: EffectKind, law: RandomLaw, scorer: Scorer) -> list[Candidate]:
    """Find a level of the walk of all that changes at a row.

    The most likely step of every mode at every row is E[w | record] = q/(q + λ) z in the modes of
    the floor: it shows a walk k times as strong as far as the walk is above the noise, and counts
    for fewer rows than there are, as it is smooth.
    """
    space = scorer.space
    transform, noise = space.transform, space.noise
    variance = noise.variance(transform)
    walk = variance - transform.eigenvalue[:, None]
    moving = np.all(walk > 0.0, axis=0)
    walk, variance = walk[:, moving], variance[:, moving]
    seen = transform.turn((scorer.left @ noise.modes[:, moving]) * np.sqrt(walk) / variance)
    share = walk / variance
    total, by_walk = share.sum(axis=0), np.sum(share**2, axis=0)
    counted, level = total**2 / (len(transform) * by_walk), total / len(transform)
    parts = np.array_split(seen**2 / level, LEVEL_WINDOWS)
    square = np.stack([part.mean(axis=0) for part in parts])
    count = np.array([len(part) for part in parts], dtype=float)[:, None]
    best, tried = (-np.inf, 1.0, 0), 0
    for factor, begin, late in _beginnings():
        before = by_walk / (1.0 + (factor**2 - 1.0) * np.mean(late))  # the floor has both together
        rest = total - by_walk
        stronger = (factor**2 * before + rest) / (before + rest)
        gain = _level_gain(square, count, np.where(late[:, None], stronger, 1.0))
        best, tried = max(best, (float(gain @ counted), factor, begin)), tried + 1
    gain, factor, begin = best
    onset = int(transform.step_rows()[sum(len(part) for part in parts[:begin])])
    values = {kind.parameters[0].name: factor}
    cost = VALUE_COST + float(np.log(tried))
    return [Candidate(kind, (), (), values, gain - cost, onset=onset, noisy=True)]


def free_level(scorer: Scorer) -> tuple[float, Vector]:
    """Log evidence that the level of the noise follows the beam, by a law that nobody names.

    The variance is any sum of how far the beam is from its mean and from the middle of the BPM, of
    that squared, and of the length and the square of its step. Each of these costs ½ ln T (G.
    Schwarz, Ann. Statist. 6 (1978) 461). The score of the sum has the variance that the record
    shows (H. White, Econometrica 50 (1982) 1), so that tails alone tell nothing. What goes with
    time is left out: effects of the library do.

    Returns:
        Of one law of all BPMs, and of a law of every BPM for itself, shape (n,) [nats].
    """
    space = scorer.space
    noise = ReadingNoise.of(scorer).values
    rows, orbit = space.transform.step_rows(), space.signals.orbit
    now, step = orbit[rows], orbit[rows] - orbit[rows - 1]
    about = now - now.mean(axis=0)
    course = np.pi * (np.arange(len(rows)) + 0.5) / len(rows)
    waves = np.cos(course[:, None] * np.arange(LEVEL_WINDOWS + 1))
    waves /= np.sqrt(np.sum(waves**2, axis=0))

    def scaled(motion: Matrix) -> Matrix:
        return motion / np.maximum(np.mean(motion, axis=0), 1e-300)

    def steady(motion: Matrix) -> Matrix:
        return motion - waves @ (waves.T @ motion)

    square = steady(noise**2 / np.mean(noise**2, axis=0))
    follows = np.stack(
        [
            square * steady(scaled(its))
            for its in (np.abs(about), about**2, np.abs(now), np.abs(step), step**2)
        ],
        axis=2,
    )
    score = follows.sum(axis=0)
    spread = np.einsum("tdk,tdl->dkl", follows, follows)
    cost = 0.5 * score.shape[1] * float(np.log(len(rows)))

    def worth(score: Matrix, spread: Matrix) -> Vector:
        shown = np.linalg.pinv(spread, hermitian=True) @ score[..., None]
        return 0.5 * np.sum(score * shown[..., 0], axis=-1) - cost

    return float(worth(score.sum(axis=0), spread.sum(axis=0))), worth(score, spread)


def _odd_level(kind: EffectKind, law: RandomLaw, scorer: Scorer) -> list[Candidate]:
    """Find BPMs whose noise is far from that of the others, as far as the others are alike.

    The logarithms of the others' variances have a mean and a scatter, which is large in a ring
    whose BPMs are of several makes; one that is odd may be anywhere within `ANYWHERE`.
    """
    level = np.log(scorer.space.noise.reading)
    known = 2.0 / len(scorer.space.transform)
    odd: list[int] = []
    gain, middle = 0.0, 0.0
    cost = float(np.log(len(level))) + MORE
    while len(odd) < len(level) // ODD:
        others = np.delete(np.arange(len(level)), odd)
        middle = float(np.median(level[others]))
        scatter = TO_SIGMA * float(np.median(np.abs(level[others] - middle)))
        variance = scatter**2 * (1.0 + 1.0 / len(others)) + known
        away = (level - middle) ** 2 / (2.0 * variance)
        more = away + 0.5 * np.log(2.0 * np.pi * variance) - np.log(ANYWHERE)
        more[odd] = -np.inf
        place = int(np.argmax(more))
        if more[place] < cost:
            break
        odd.append(place)
        gain += float(more[place]) - cost
    if not odd:
        return []
    factor = float(np.exp(0.5 * (level[odd[0]] - middle)))
    places = tuple(sorted(odd))
    names = tuple(law.names[place] for place in places)
    values = {kind.parameters[0].name: factor}
    return [Candidate(kind, places, names, values, gain - VALUE_COST, noisy=True, courseless=True)]


def _level_gain(square: Matrix, count: Matrix, shape: Matrix) -> Vector:
    """Log likelihood of a course of the variance over a constant one, levels free, by column."""
    level = np.sum(count * square / shape, axis=0) / count.sum()
    flat = np.sum(count * square, axis=0) / count.sum()
    variance = shape * level
    one = np.sum(-0.5 * count * (np.log(variance) + square / variance), axis=0)
    other = np.sum(-0.5 * count * (np.log(flat) + square / flat), axis=0)
    return one - other


def _all_or_some(gain: Vector) -> tuple[float, tuple[int, ...]]:
    """Evidence of all BPMs, or of those that have it beyond what choosing them costs."""
    cost = float(np.log(len(gain)))
    chosen = np.flatnonzero(gain > cost + MORE)
    some = float(np.sum(gain[chosen] - cost)) if len(chosen) else -np.inf
    every = float(np.sum(gain))
    if every >= some:
        return every, ()
    return some, tuple(int(place) for place in chosen)


def scan_colour(kind: EffectKind, law: RandomLaw, scorer: Scorer) -> list[Candidate]:
    """Find BPMs whose noise remembers: its spectrum against a flat one, by correlation."""
    space = scorer.space
    transform = space.transform
    noise = transform.turn(ReadingNoise.of(scorer).values)
    part = transform.eigenvalue > 0.3
    eigenvalue = transform.eigenvalue[part]
    share = eigenvalue[:, None] / space.noise.variance_at(eigenvalue)
    power = noise[part] ** 2 / (share @ (space.noise.modes**2).T)
    flat = np.mean(power, axis=0)
    best: tuple[float, tuple[int, ...], float] = (-np.inf, (), 0.0)
    cosine = 1.0 - 0.5 * eigenvalue
    for kept in (-0.8, -0.5, -0.25, 0.25, 0.5, 0.8):
        shape = ((1.0 - kept**2) / (1.0 - 2.0 * kept * cosine + kept**2))[:, None]
        level = np.mean(power / shape, axis=0)
        gain = np.sum(
            -0.5 * (np.log(shape * level) + power / (shape * level))
            + 0.5 * (np.log(flat) + power / flat),
            axis=0,
        )
        found, places = _all_or_some(gain)
        if found > best[0]:
            best = (found, places, kept)
    gain, places, kept = best
    values = {kind.parameters[0].name: float(kept)}
    names = tuple(law.names[place] for place in places)
    gain -= VALUE_COST + float(np.log(6.0))
    return [Candidate(kind, places, names, values, gain, noisy=True, coloured=True)]
