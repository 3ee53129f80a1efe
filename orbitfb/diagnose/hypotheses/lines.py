"""Lines: what swings at one frequency, all frequencies at once by a Fourier transform."""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.row_sums import Turned
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import DeviceLaw
from orbitfb.estimation.priors import (
    LINE_FINER,
    LINE_FINEST,
    LINE_PERIODS,
    LINE_VARIANCES,
    VALUE_COST,
)
from orbitfb.estimation.transform import Matrix


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """The strongest line of some patterns.

    Args:
        evidence: Log evidence less what frequency and place cost.
        place: Number of the pattern.
        cycles: Per row.
        field: Spectrum of what it adds, shape (T, n) [m].
        cosine: Amplitude of the pattern's cosine, counted from the first row.
        sine: Of its sine.
    """

    evidence: float
    place: int
    cycles: float
    field: Matrix
    cosine: float
    sine: float


def strongest_line(scorer: Scorer, patterns: Matrix, shaped: bool) -> Line:
    """Find the strongest line.

    Args:
        scorer: Of what is left to explain.
        patterns: Of the places, shape (n, P) [m].
        shaped: Whether several places may swing together: the line then has any shape that the
            ground's walk may have, and the place is the one that alone explains most of it.
    """
    count = len(scorer.rows.late)
    # Beside half the rate, as beside zero, cosine and sine are one wave, which is as noise is.
    last = (count // 2 - LINE_PERIODS) * LINE_FINER
    cycles = np.arange(LINE_PERIODS * LINE_FINER, last) / (count * LINE_FINER)
    turned = scorer.rows.fourier(LINE_FINER)[LINE_PERIODS * LINE_FINER :][: len(cycles)]
    gain = _gains(scorer, turned, cycles, patterns, shaped)
    top = float(cycles[np.unravel_index(int(np.argmax(gain)), gain.shape)[0]])
    near = top + np.arange(-LINE_FINEST, LINE_FINEST + 1) / (LINE_FINEST * LINE_FINER * count)
    wave = np.exp(-2j * np.pi * np.outer(near, np.arange(count)))
    fine = _gains(
        scorer, np.asarray(wave @ scorer.rows.late, dtype=np.complex128), near, patterns, shaped
    )
    line, place = np.unravel_index(int(np.argmax(fine)), fine.shape)
    variance: float | None = None
    if shaped:
        told = np.asarray(wave[line : line + 1] @ scorer.rows.late, dtype=np.complex128)
        place = int(np.argmax(_gains(scorer, told, near[line : line + 1], patterns, False)))
        worth = _by_variance(scorer, told, near[line : line + 1])
        variance = float(LINE_VARIANCES[int(np.argmax(worth))])
    field, cosine, sine = _field(scorer, patterns[:, place], float(near[line]), variance)
    choices = 1 if shaped else patterns.shape[1]
    evidence = float(fine.max()) - np.log(count) - np.log(choices) - VALUE_COST
    return Line(evidence, int(place), float(near[line]), field, cosine, sine)


def scan_lines(kind: EffectKind, law: DeviceLaw, scorer: Scorer) -> list[Candidate]:
    """Find the frequency and the place of the strongest line.

    Args:
        kind: Whose parameters are the amplitudes of cosine and sine, and the frequency [Hz].
        law: Of it: patterns of the places, courses the same for all.
        scorer: Of what is left to explain.
    """
    period = scorer.space.signals.record.layout.period
    lines = [strongest_line(scorer, law.patterns[0], shaped) for shaped in (False, True)]
    best = max(lines, key=lambda one: one.evidence)
    amplitudes = (best.cosine, best.sine, best.cycles / period)
    values = {p.name: v for p, v in zip(kind.parameters, amplitudes, strict=False)}
    names = (law.names[best.place],)
    return [Candidate(kind, (best.place,), names, values, best.evidence, field=best.field)]


def _gains(
    scorer: Scorer, turned: Turned, cycles: Vector, patterns: Matrix, shaped: bool
) -> Matrix:
    """Log evidence of a line of every frequency, shape (F, P), or (F, 1) of any shape.

    Args:
        scorer: Of what is left to explain.
        turned: Σ_n (Ω z)_n exp(−iωn), shape (F, n).
        cycles: Frequencies per row, shape (F,).
        patterns: Shape (n, P).
        shaped: Whether the line has the ground's shape.
    """
    noise = scorer.space.noise
    level = 2.0 - 2.0 * np.cos(2.0 * np.pi * cycles)
    eigenvalue = level[:, None]
    weight = 0.5 * len(scorer.rows.late) * eigenvalue / noise.variance_at(level)
    if shaped:
        return _by_variance(scorer, turned, cycles).max(axis=0)[:, None]
    information = weight @ ((patterns.T @ noise.modes) ** 2).T
    square = np.abs(turned @ patterns) ** 2 * eigenvalue / np.maximum(information, 1e-300)
    best = np.clip(0.5 * square, 1.0 + LINE_VARIANCES[0], 1.0 + LINE_VARIANCES[-1])  # 1 + variance
    return np.asarray(0.5 * square * (1.0 - 1.0 / best) - np.log(best))


def _by_variance(scorer: Scorer, turned: Turned, cycles: Vector) -> Matrix:
    """Log evidence of a line of the ground's shape, of every variance and frequency, (V, F)."""
    noise = scorer.space.noise
    level = 2.0 - 2.0 * np.cos(2.0 * np.pi * cycles)
    eigenvalue = level[:, None]
    weight = 0.5 * len(scorer.rows.late) * eigenvalue / noise.variance_at(level)
    along = turned @ (noise.white @ noise.modes)
    square = np.abs(along) ** 2 * eigenvalue / weight
    ground = noise.ratio / np.mean(noise.ratio)
    found = []
    for variance in LINE_VARIANCES:
        prior = variance * ground * weight / np.mean(weight, axis=1, keepdims=True)
        share = prior / (1.0 + prior)
        found.append(np.sum(0.5 * square * share - np.log1p(prior), axis=1))
    return np.array(found)


def _field(
    scorer: Scorer, pattern: Vector, cycles: float, variance: float | None
) -> tuple[Matrix, float, float]:
    """Spectrum of the most likely line, and the amplitudes of one pattern's cosine and sine.

    Args:
        scorer: Of what is left to explain.
        pattern: Of the place, shape (n,) [m].
        cycles: Per row.
        variance: Of a line of the ground's shape, over what the noise leaves uncertain of it; None:
            it has the shape of the pattern.
    """
    transform, noise = scorer.space.transform, scorer.space.noise
    phase = 2.0 * np.pi * cycles * np.arange(transform.rows)
    waves = transform.spectrum(np.stack([np.cos(phase), np.sin(phase)], axis=1))
    weight = 1.0 / noise.variance(transform)
    gram = np.einsum("fa,fb,fm->mab", waves, waves, weight)
    pulls = np.einsum("fa,fm->ma", waves, scorer.pulled @ (noise.white @ noise.modes))
    seen = pattern @ noise.modes
    total = np.einsum("m,mab->ab", seen**2, gram)
    own = np.linalg.solve(total + 1e-12 * np.trace(total) * np.eye(2), seen @ pulls)
    if variance is None:
        alone = np.asarray(np.outer(waves @ own, pattern), dtype=np.float64)
        return alone, float(own[0]), float(own[1])
    ground = np.trace(gram.sum(axis=0)) / (2.0 * len(gram)) * np.mean(noise.ratio)
    prior = noise.ratio / max(ground, 1e-300)
    inner = gram + np.eye(2) / np.maximum(variance * prior, 1e-12)[:, None, None]
    size = np.asarray(np.linalg.solve(inner, pulls[:, :, None]), dtype=np.float64)[:, :, 0]
    field = np.asarray((waves @ size.T) @ (noise.modes.T @ noise.white), dtype=np.float64)
    return field, float(own[0]), float(own[1])
