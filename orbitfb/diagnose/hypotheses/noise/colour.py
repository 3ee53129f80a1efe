"""Noise that remembers from row to row."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.noise.readings import ReadingNoise, all_or_some, told_finely
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import RandomLaw
from orbitfb.estimation.priors import VALUE_COST

_COLOURS = (-0.8, -0.5, -0.25, 0.25, 0.5, 0.8)
"""Correlations from row to row that are scanned."""
_MOST_KEPT = 0.98
"""Largest correlation from row to row. By hand: of more it is a walk."""


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
        found, places = all_or_some(by_bpm(kept))
        if found > best[0]:
            best = (found, places, kept)
    gain, places, kept = best
    names = tuple(law.names[place] for place in places)
    gain -= VALUE_COST + float(np.log(len(_COLOURS)))
    values = {kind.parameters[0].name: kept}
    one = Candidate(kind, places, names, values, gain, noisy=True, coloured=True)
    chosen = list(places) if places else slice(None)
    return [
        told_finely(
            one,
            lambda value: float(np.sum(by_bpm(np.clip(value, -_MOST_KEPT, _MOST_KEPT))[chosen])),
        )
    ]
