"""Laws of the reading noise itself: its level in time or with the beam, its memory, its tails."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.optimize import minimize

from orbitfb.core.robust import TO_SIGMA
from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.refit import nearby
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import RandomLaw
from orbitfb.estimation.priors import (
    ANYWHERE,
    BEND,
    KNOWN_TO,
    LEVEL_RATIOS,
    LEVEL_WINDOWS,
    MORE,
    ODD,
    STRENGTHS,
    STRUCK_SHARES,
    VALUE_COST,
)
from orbitfb.estimation.transform import Matrix

_COLOURS = (-0.8, -0.5, -0.25, 0.25, 0.5, 0.8)
"""Correlations of the noise from row to row that are scanned."""
_MOST_KEPT = 0.98
"""Largest correlation of the noise from row to row: of more it is a walk."""
_LEVEL_STEP = 1.9
"""Factor from one level or correlation that is scanned to the next, at most."""
_LEAST_LEVEL = 1e-6
"""Least variance of readings that are not struck, of all of them [1]."""
_LEVEL_TURNS = 8
"""Turns in which the level of readings that are not struck is told."""
_MOST_STRUCK = 0.5
"""Largest share of the readings that are struck: of more, the others are the odd ones."""


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
    shapes = [(factor, 0, middle) for factor in LEVEL_RATIOS]
    shapes += [(factor, begin, late.astype(float)) for factor, begin, late in _beginnings()]

    def by_bpm(factor: float, share: Vector) -> Vector:
        return _level_gain(square, count, (1.0 + (factor - 1.0) * share[:, None]) ** 2)

    for factor, begin, share in shapes:
        found, places = _all_or_some(by_bpm(factor, share))
        if found > best[0]:
            best = (found, places, factor, begin)
    gain, places, factor, begin = best
    share = np.arange(LEVEL_WINDOWS) >= begin if begin else middle
    rows = scorer.space.transform.step_rows()
    onset = int(rows[sum(len(part) for part in parts[:begin])]) if begin else 0
    names = tuple(law.names[place] for place in places)
    cost = VALUE_COST + float(np.log(len(shapes)))
    coarse = Candidate(
        kind, places, names, {kind.parameters[0].name: factor}, gain - cost, onset=onset, noisy=True
    )
    chosen = list(places) if places else slice(None)
    course = _refined(coarse, lambda value: float(np.sum(by_bpm(value, share)[chosen])))
    return [course, *_odd_level(kind, law, scorer)]


def _refined(one: Candidate, worth: Callable[[float], float]) -> Candidate:
    """A candidate of a grid whose level is told between the values of the grid if it leads."""
    ((name, value),) = one.values.items()

    def finer() -> Candidate:
        best, spread = nearby(worth, value, _LEVEL_STEP)
        more = max(worth(best) - worth(value), 0.0)
        return replace(
            one, values={name: best}, evidence=one.evidence + more, spread={name: spread},
            finer=None,
        )  # fmt: skip

    return replace(one, finer=finer)


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
    return [_refined(one, lambda value: worth(value, late))]


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
            spread={name: spread},
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

    def by_bpm(kept: float) -> Vector:
        shape = ((1.0 - kept**2) / (1.0 - 2.0 * kept * cosine + kept**2))[:, None]
        level = np.mean(power / shape, axis=0)
        return np.asarray(np.sum(
            -0.5 * (np.log(shape * level) + power / (shape * level))
            + 0.5 * (np.log(flat) + power / flat),
            axis=0,
        ))  # fmt: skip

    for kept in _COLOURS:
        found, places = _all_or_some(by_bpm(kept))
        if found > best[0]:
            best = (found, places, kept)
    gain, places, kept = best
    names = tuple(law.names[place] for place in places)
    gain -= VALUE_COST + float(np.log(len(_COLOURS)))
    values = {kind.parameters[0].name: kept}
    one = Candidate(kind, places, names, values, gain, noisy=True, coloured=True)
    chosen = list(places) if places else slice(None)
    return [
        _refined(
            one,
            lambda value: float(np.sum(by_bpm(np.clip(value, -_MOST_KEPT, _MOST_KEPT))[chosen])),
        )
    ]


@dataclass(frozen=True, slots=True, eq=False)
class Tails:
    """Readings of BPMs of which some are struck: normal noise, and now and then wider one.

    Args:
        noise: Of the readings, over its rms, shape (T, k).
        rms: Of it as the floor has it, shape (k,) [m].
    """

    noise: Matrix
    rms: Vector

    @classmethod
    def of(cls, scorer: Scorer, places: Sequence[int] = ()) -> "Tails":
        """Of some BPMs; none: of all."""
        chosen = list(places) if places else slice(None)
        noise = ReadingNoise.of(scorer).values[:, chosen]
        rms = np.sqrt(scorer.space.noise.reading[chosen])
        return cls(noise / np.sqrt(np.mean(noise**2, axis=0)), rms)

    def gain(self, share: float, height: float | Vector, level: float | Vector) -> Vector:
        """Log likelihood over that of normal noise, by BPM, shape (k,).

        Args:
            share: Of the readings that are struck.
            height: Variance of a strike, over that of all noise, shape (k,) or one for all.
            level: Variance of the readings that are not struck, likewise.
        """
        usual, struck = self._each(share, height, level)
        return np.asarray(np.sum(np.logaddexp(usual, struck) + 0.5 * self.noise**2, axis=0))

    def worth(self, values: Vector) -> float:
        """The same of all BPMs, for the logarithms of share and rms of the strikes [m].

        The level of each BPM is its most likely one (A. Dempster, N. Laird, D. Rubin, J. R. Stat.
        Soc. B 39 (1977) 1).
        """
        share, amplitude = np.exp(values)
        share, height = min(share, _MOST_STRUCK), (amplitude / self.rms) ** 2
        level = np.maximum(1.0 - share * height, _LEAST_LEVEL)
        for _ in range(_LEVEL_TURNS):
            usual, struck = self._each(share, height, level)
            spared = 1.0 / (1.0 + np.exp(np.clip(struck - usual, -700.0, 700.0)))
            spread = level * height / (level + height)  # of what a struck one has beside its strike
            part = level / (level + height) * self.noise
            own = spared * self.noise**2 + (1.0 - spared) * (part**2 + spread)
            level = np.maximum(np.mean(own, axis=0), _LEAST_LEVEL)
        return float(np.sum(self.gain(share, height, level)))

    def _each(
        self, share: float, height: float | Vector, level: float | Vector
    ) -> tuple[Matrix, Matrix]:
        wide = level + height
        usual = np.log1p(-share) - 0.5 * (self.noise**2 / level + np.log(level))
        return usual, np.log(share) - 0.5 * (self.noise**2 / wide + np.log(wide))

    def spread(self, values: Vector) -> Vector:
        """Standard deviations of these logarithms, each if the other is free, shape (2,)."""
        bent = np.eye(2) / KNOWN_TO**2
        for one, other in product(range(2), range(2)):
            step, along = BEND * np.eye(2)[one], BEND * np.eye(2)[other]
            corners = [values + s * step + t * along for s, t in product((1, -1), (1, -1))]
            both, up, down, none = map(self.worth, corners)
            bent[one, other] -= (both - up - down + none) / (4.0 * BEND**2)
        return np.sqrt(np.diag(np.linalg.inv(bent)))


def scan_tails(kind: EffectKind, scorer: Scorer) -> Candidate:
    """Find single readings that are struck now and then, of all BPMs or of some."""
    tails = Tails.of(scorer)
    best: tuple[float, tuple[int, ...], float, float] = (-np.inf, (), 0.0, 0.0)
    for share, strength in product(STRUCK_SHARES, STRENGTHS):
        height = strength**2 / (1.0 + share * strength**2)
        found, places = _all_or_some(tails.gain(share, height, 1.0 - share * height))
        if found > best[0]:
            best = (found, places, share, height)
    gain, places, share, height = best
    first, second = (parameter.name for parameter in kind.parameters)
    bpms = scorer.space.signals.record.layout.bpms
    told = tuple(bpms.label(place) for place in places)
    own = Tails.of(scorer, places)
    begin = np.log([share, float(np.median(own.rms)) * np.sqrt(height)])

    def candidate(logs: Vector, gain: float, spread: Sequence[float] = ()) -> Candidate:
        values = dict(zip((first, second), map(float, np.exp(logs)), strict=True))
        known = dict(zip((first, second), spread, strict=False))
        return Candidate(
            kind, places, told, values, gain - 2 * VALUE_COST, noisy=True, spread=known
        )

    def finer() -> Candidate:
        fine = minimize(lambda at: -own.worth(at), begin, method="Nelder-Mead").x
        fine[0] = min(fine[0], np.log(_MOST_STRUCK))
        more = max(own.worth(fine) - own.worth(begin), 0.0)
        return candidate(fine, gain + more, own.spread(fine).tolist())

    return replace(candidate(begin, gain), finer=finer)
