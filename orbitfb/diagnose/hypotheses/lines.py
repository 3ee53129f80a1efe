"""Lines: what swings at one frequency, all frequencies at once by a Fourier transform."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate, strongest
from orbitfb.diagnose.hypotheses.device_laws import choices
from orbitfb.diagnose.hypotheses.row_sums import Turned
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.corrected import over
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import DeviceLaw
from orbitfb.estimation.maxima import highest
from orbitfb.estimation.priors import (
    FINENESS,
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
        evidence: Log evidence less what frequency and places cost.
        places: Numbers of the patterns, the strongest first.
        cycles: Per row.
        field: Spectrum of what it adds, shape (T, n) [m].
        cosine: Amplitude of the first pattern's cosine, counted from the first row.
        sine: Of its sine.
    """

    evidence: float
    places: tuple[int, ...]
    cycles: float
    field: Matrix
    cosine: float
    sine: float


Way = Callable[[Scorer, Matrix], Line | None]
"""Finds the strongest line of patterns, shape (n, P) [m]."""

Worth = Callable[[Turned, Vector], Matrix]
"""Log evidence of lines, given the Fourier sums and the frequencies, shape (F, P)."""


def strongest_line(scorer: Scorer, patterns: Matrix, shaped: bool) -> Line:
    """Find the strongest line.

    Args:
        scorer: Of what is left to explain.
        patterns: Of the places, shape (n, P) [m].
        shaped: Whether several places may swing together: the line then has any shape that the
            ground's walk may have, and the place is the one that alone explains most of it.
    """
    fine, cycles, told = _highest(scorer, partial(_gains, scorer, patterns, shaped))
    variance: float | None = None
    alone, at = fine, np.array([cycles])
    if shaped:
        alone = _gains(scorer, patterns, False, told, at)
        variance = float(LINE_VARIANCES[int(np.argmax(_by_variance(scorer, told, at)))])
    place = int(np.argmax(alone))
    field, cosine, sine = _field(scorer, patterns[:, place], cycles, variance)
    choices = 1 if shaped else patterns.shape[1]
    evidence = float(fine.max()) - np.log(len(scorer.rows.late)) - np.log(choices) - VALUE_COST
    return Line(evidence, (place,), cycles, field, cosine, sine)


def line_of_some(scorer: Scorer, patterns: Matrix) -> Line | None:
    """Find the line that some patterns have, each with amplitudes of its own; None: there is none.

    They are taken in one by one, the one that then explains most each time, while it explains more
    than its choice costs.

    Args:
        scorer: Of what is left to explain.
        patterns: Shape (n, P) [m].
    """
    cost = float(np.log(patterns.shape[1]))

    def worth(turned: Turned, cycles: Vector) -> Matrix:
        each = _gains(scorer, patterns, False, turned, cycles)
        return np.sum(np.maximum(each - cost, 0.0), axis=1, keepdims=True)

    _, cycles, _ = _highest(scorer, worth)
    waves, gram, pulls = _seen(scorer, cycles)
    seen = patterns.T @ scorer.space.noise.modes
    pull = seen @ pulls
    information = (seen * (0.5 * np.trace(gram, axis1=1, axis2=2))) @ seen.T
    chosen: list[int] = []
    sizes, evidence = np.zeros((0, 2)), 0.0
    while True:
        rest = pull - information[:, chosen] @ sizes
        gain = _of_any_size(np.sum(rest**2, axis=1) / np.diag(information)) - cost
        gain[chosen] = 0.0
        best = int(np.argmax(gain))
        if gain[best] <= 0.0:
            break
        evidence += float(gain[best])
        chosen.append(best)
        sizes = np.linalg.solve(information[np.ix_(chosen, chosen)], pull[chosen])
    if not chosen:
        return None
    order = np.argsort(-np.hypot(*sizes.T))
    field = np.asarray(waves @ (patterns[:, chosen] @ sizes).T, dtype=np.float64)
    cosine, sine = map(float, sizes[order[0]])
    evidence -= float(np.log(len(scorer.rows.late))) + VALUE_COST
    return Line(evidence, tuple(chosen[at] for at in order), cycles, field, cosine, sine)


def scan_lines(kind: EffectKind, law: DeviceLaw, scorer: Scorer) -> list[Candidate]:
    """Find the frequency and the places of the strongest line.

    What swings at BPMs swings at each for itself; what moves the beam, wherever it is, does so
    with a shape that the ground has.

    Args:
        kind: Whose parameters are the amplitudes of cosine and sine, and the frequency [Hz].
        law: Of it: patterns of the places, courses the same for all.
        scorer: Of what is left to explain.
    """
    ways: list[Way] = [partial(strongest_line, shaped=False), partial(strongest_line, shaped=True)]
    if kind.target == "bpm":
        ways = [line_of_some]
    lines = [_told(kind, law, scorer, way) for way in ways]
    return strongest([one for one in lines if one is not None])[:1]


def _told(
    kind: EffectKind, law: DeviceLaw, scorer: Scorer, way: Way, won: float | None = None
) -> Candidate | None:
    """The line that is found in one way; it is found anew over a floor that was told with it.

    Args:
        kind: The effect.
        law: Of it.
        scorer: Of what is left to explain.
        way: The way.
        won: Evidence that it keeps over other floors [nats]: a wave is no law that is a little
            wrong, and leaves others no share of what it weighs over the floor without it. None:
            this is the first.
    """
    line = way(scorer, law.patterns[0])
    if line is None:
        return None
    amplitudes = (line.cosine, line.sine, line.cycles / scorer.space.signals.record.layout.period)
    values = {p.name: v for p, v in zip(kind.parameters, amplitudes, strict=False)}
    names = tuple(law.names[place] for place in line.places)
    evidence = line.evidence + len(names) * np.log(len(law.names)) - choices(law, line.places)
    cost = scorer.likelihood(line.field) - evidence
    kept = evidence if won is None else won
    one = Candidate(
        kind, line.places, names, values, kept, field=line.field, cost=cost, cycles=line.cycles
    )

    def again(after: Workspace) -> Candidate:
        fresh = _told(kind, law, Scorer.of(over(scorer.space, after)), way, kept)
        return replace(one, evidence=0.0) if fresh is None else fresh

    return replace(one, again=again)


def _highest(scorer: Scorer, worth: Worth) -> tuple[Matrix, float, Turned]:
    """Look at all frequencies, and once more near the best.

    Returns:
        Log evidence at the best frequency, shape (1, P), that frequency per row, and the Fourier
        sums there, shape (1, n).
    """
    count = len(scorer.rows.late)
    # Beside half the rate, as beside zero, cosine and sine are one wave, which is as noise is.
    last = (count // 2 - LINE_PERIODS) * LINE_FINER
    cycles = np.arange(LINE_PERIODS * LINE_FINER, last) / (count * LINE_FINER)
    turned = scorer.rows.fourier(LINE_FINER)[LINE_PERIODS * LINE_FINER :][: len(cycles)]
    top = float(cycles[int(np.argmax(worth(turned, cycles).max(axis=1)))])
    near = top + np.arange(-LINE_FINEST, LINE_FINEST + 1) / (LINE_FINEST * LINE_FINER * count)
    wave = np.exp(-2j * np.pi * np.outer(near, np.arange(count)))
    told = np.asarray(wave @ scorer.rows.late, dtype=np.complex128)
    line = int(np.argmax(worth(told, near).max(axis=1)))

    def at(frequency: float) -> Turned:
        wave = np.exp(-2j * np.pi * frequency * np.arange(count))
        return np.asarray(wave[None, :] @ scorer.rows.late, dtype=np.complex128)

    def best(frequency: float) -> float:
        return float(worth(at(frequency), np.array([frequency])).max())

    step = 1.0 / (LINE_FINEST * LINE_FINER * count)
    found = highest(best, (float(near[line]) - step, float(near[line]) + step), FINENESS)
    turned = at(found)
    return worth(turned, np.array([found])), found, turned


def _gains(
    scorer: Scorer, patterns: Matrix, shaped: bool, turned: Turned, cycles: Vector
) -> Matrix:
    """Log evidence of a line of every frequency, shape (F, P), or (F, 1) of any shape.

    Args:
        scorer: Of what is left to explain.
        patterns: Shape (n, P).
        shaped: Whether the line has the ground's shape.
        turned: Σ_n (Ω z)_n exp(−iωn), shape (F, n).
        cycles: Frequencies per row, shape (F,).
    """
    noise = scorer.space.noise
    level = 2.0 - 2.0 * np.cos(2.0 * np.pi * cycles)
    eigenvalue = level[:, None]
    weight = 0.5 * len(scorer.rows.late) * eigenvalue / noise.variance_at(level)
    if shaped:
        return _by_variance(scorer, turned, cycles).max(axis=0)[:, None]
    information = weight @ ((patterns.T @ noise.modes) ** 2).T
    square = np.abs(turned @ patterns) ** 2 * eigenvalue / np.maximum(information, 1e-300)
    return _of_any_size(square)


def _of_any_size(square: Matrix) -> Matrix:
    """Log evidence of amplitudes whose prior variance is the likeliest of any.

    Args:
        square: Σ pull² over the information, of cosine and sine together [1].
    """
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
    noise = scorer.space.noise
    waves, gram, pulls = _seen(scorer, cycles)
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


def _seen(scorer: Scorer, cycles: float) -> tuple[Matrix, Matrix, Matrix]:
    """Spectra of cosine and sine, (T, 2), their products by mode, (n, 2, 2), and pulls, (n, 2)."""
    transform, noise = scorer.space.transform, scorer.space.noise
    phase = 2.0 * np.pi * cycles * np.arange(transform.rows)
    waves = transform.spectrum(np.stack([np.cos(phase), np.sin(phase)], axis=1))
    gram = np.einsum("fa,fb,fm->mab", waves, waves, 1.0 / noise.variance(transform))
    pulls = np.einsum("fa,fm->ma", waves, scorer.pulled @ (noise.white @ noise.modes))
    return waves, gram, pulls
