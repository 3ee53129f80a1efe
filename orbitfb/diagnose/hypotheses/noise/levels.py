"""Levels of the noise: another from a row on, growing, with the beam, or unlike that of others."""

from collections.abc import Iterator

import numpy as np

from orbitfb.core.robust import TO_SIGMA
from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.noise.readings import ReadingNoise, all_or_some, told_finely
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import RandomLaw
from orbitfb.estimation.priors import ANYWHERE, LEVEL_RATIOS, LEVEL_WINDOWS, MORE, ODD, VALUE_COST
from orbitfb.estimation.transform import Matrix


def scan_level(kind: EffectKind, law: RandomLaw, scorer: Scorer) -> list[Candidate]:
    """Find a level of the noise that changes within the record, of all BPMs or of some."""
    noise = ReadingNoise.of(scorer).values
    parts = np.array_split(noise**2, LEVEL_WINDOWS)
    square = np.stack([part.mean(axis=0) for part in parts])
    count = np.array([len(part) for part in parts], dtype=float)[:, None]
    middle = (np.arange(LEVEL_WINDOWS) + 0.5) / LEVEL_WINDOWS
    best: tuple[float, tuple[int, ...], float, int] = (-np.inf, (), 1.0, 0)
    shapes = [(factor, 0, middle) for factor in LEVEL_RATIOS]
    shapes += [(factor, begin, late.astype(float)) for factor, begin, late in _beginnings()]

    def by_bpm(factor: float, share: Vector) -> Vector:
        return _level_gain(square, count, (1.0 + (factor - 1.0) * share[:, None]) ** 2)

    for factor, begin, share in shapes:
        found, places = all_or_some(by_bpm(factor, share))
        if found > best[0]:
            best = (found, places, factor, begin)
    gain, places, factor, begin = best
    share = (np.arange(LEVEL_WINDOWS) >= begin).astype(float) if begin else middle
    rows = scorer.space.transform.step_rows()
    onset = int(rows[sum(len(part) for part in parts[:begin])]) if begin else 0
    names = tuple(law.names[place] for place in places)
    cost = VALUE_COST + float(np.log(len(shapes)))
    coarse = Candidate(
        kind, places, names, {kind.parameters[0].name: factor}, gain - cost, onset=onset, noisy=True
    )
    chosen = list(places) if places else slice(None)
    course = told_finely(coarse, lambda value: float(np.sum(by_bpm(value, share)[chosen])))
    return [course, *_odd_level(kind, law, scorer)]


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

    def worth(factor: float, late: Mask) -> float:
        before = by_walk / (1.0 + (factor**2 - 1.0) * np.mean(late))  # the floor has both together
        rest = total - by_walk
        stronger = (factor**2 * before + rest) / (before + rest)
        gain = _level_gain(square, count, np.where(late[:, None], stronger, 1.0))
        return float(gain @ counted)

    tried = [(worth(factor, late), factor, begin) for factor, begin, late in _beginnings()]
    gain, factor, begin = max(tried)
    onset = int(transform.step_rows()[sum(len(part) for part in parts[:begin])])
    cost = VALUE_COST + float(np.log(len(tried)))
    values = {kind.parameters[0].name: factor}
    one = Candidate(kind, (), (), values, gain - cost, onset=onset, noisy=True)
    late = np.arange(LEVEL_WINDOWS) >= begin
    return [told_finely(one, lambda value: worth(value, late))]


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


def _beginnings() -> Iterator[tuple[float, int, Mask]]:
    """Ratios of levels, the window from which a level is another one, and which windows are."""
    for factor in LEVEL_RATIOS:
        for begin in range(2, LEVEL_WINDOWS - 1, 2):
            yield factor, begin, np.arange(LEVEL_WINDOWS) >= begin


def _odd_level(kind: EffectKind, law: RandomLaw, scorer: Scorer) -> list[Candidate]:
    """Find BPMs whose noise is far from that of the others, as far as the others are alike.

    The logarithms of the others' variances have a mean and a scatter, which is large in a ring
    whose BPMs are of several makes; one that is odd may be anywhere within `ANYWHERE`.
    """
    level = np.log(scorer.space.noise.reading)
    known = 2.0 / len(scorer.space.transform)
    odd: list[int] = []
    gain, middle, spread = 0.0, 0.0, 0.0
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
        gain, spread = gain + float(more[place]) - cost, 0.5 * float(np.sqrt(variance))
    if not odd:
        return []
    factor = float(np.exp(0.5 * (level[odd[0]] - middle)))
    places = tuple(sorted(odd))
    names = tuple(law.names[place] for place in places)
    name = kind.parameters[0].name
    return [
        Candidate(
            kind, places, names, {name: factor}, gain - VALUE_COST, noisy=True, courseless=True,
            deviations={name: spread},
        )
    ]  # fmt: skip


def _level_gain(square: Matrix, count: Matrix, shape: Matrix) -> Vector:
    """Log likelihood of a course of the variance over a constant one, levels free, by column."""
    level = np.sum(count * square / shape, axis=0) / count.sum()
    flat = np.sum(count * square, axis=0) / count.sum()
    variance = shape * level
    one = np.sum(-0.5 * count * (np.log(variance) + square / variance), axis=0)
    other = np.sum(-0.5 * count * (np.log(flat) + square / flat), axis=0)
    return one - other
