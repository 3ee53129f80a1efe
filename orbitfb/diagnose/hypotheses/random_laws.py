"""Laws whose amplitude is random: walks, common noise, strokes that are rare."""

from dataclasses import dataclass

import numpy as np

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.lines import strongest_line
from orbitfb.diagnose.hypotheses.noise_laws import scan_colour, scan_level
from orbitfb.diagnose.hypotheses.priors import SHAPE_COUNTS, VALUE_COST
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import RandomLaw
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.transform import Matrix

_SIZES = np.geomspace(1e-3, 1e4, 36)
"""Variances that are tried, in units of what the floor leaves uncertain of the pattern."""

_RARE = (0.003, 0.01, 0.03, 0.1)
"""Shares of the rows in which a stroke comes."""


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
        return []
    space = scorer.space
    noise = StepNoise(space.shape + space.held, space.noise.white)
    mean = space.errors.mean()
    left = space.residual - space.terms.contribution(mean)
    pulled = noise.pull(left, space.transform)
    weighed = _Weighed(noise, pulled, space.transform.turn(pulled))
    steady = _steady(kind, law, space, weighed)
    if not law.walk:
        return [steady]
    found = [steady, _strokes(kind, law, space, weighed)]
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
    along = weighed.pulled @ law.patterns
    by_band = np.stack(
        [
            np.sum(along[transform.members(band)] ** 2, axis=0)
            for band in range(len(transform.count))
        ]
    )
    precision = noise.inverse_variance(transform) @ seen.T
    count = transform.count[:, None].astype(float)
    eigenvalue = (np.bincount(transform.band, transform.eigenvalue) / transform.count)[:, None]
    weight = np.ones_like(eigenvalue) if law.walk else eigenvalue
    scale = np.sum(count * precision * weight, axis=0) / count.sum()
    best, size = np.zeros(law.patterns.shape[1]), np.zeros(law.patterns.shape[1])
    for factor in _SIZES:
        variance = factor / np.maximum(scale, 1e-300) * weight
        grown = 1.0 + variance * precision
        gain = np.sum(-0.5 * count * np.log(grown) + 0.5 * variance * by_band / grown, axis=0)
        better = gain > best
        best[better], size[better] = gain[better], (factor / scale)[better]
    shown = np.sum(count * (precision * weight) ** 2, axis=0) / np.max(
        (precision * weight) ** 2, axis=0
    )
    best = best * SHAPE_COUNTS / (SHAPE_COUNTS + shown) if law.walk else best
    place = int(np.argmax(best))
    gain = float(best[place]) - np.log(len(best)) - VALUE_COST
    return _candidate(kind, law, space, place, float(size[place]), gain)


def _strokes(kind: EffectKind, law: RandomLaw, space: Workspace, weighed: _Weighed) -> Candidate:
    """Amplitudes that come in a few rows only."""
    noise = weighed.noise
    flat = 1.0 / np.sqrt(noise.ratio**2 + 4.0 * noise.ratio + 1e-12)
    own = ((law.patterns.T @ noise.modes) ** 2) @ flat
    along = weighed.late @ law.patterns
    square = along**2 / own
    normal = np.mean(square, axis=0)
    best, size = np.full(len(own), -np.inf), np.zeros(len(own))
    for share in _RARE:
        for strength in (10.0, 100.0, 1e3, 1e4):
            gain = 0.5 * square * strength / (1.0 + strength) - 0.5 * np.log1p(strength)
            mixed = np.logaddexp(np.log1p(-share), np.log(share) + gain)
            total = np.sum(mixed, axis=0)
            better = total > best
            best[better], size[better] = total[better], (share * strength / own)[better]
    # A steady walk of the same total strength explains part of it: only the tails count.
    steady = 0.5 * len(along) * (np.maximum(normal, 1.0) - 1.0 - np.log(np.maximum(normal, 1.0)))
    gain = best - steady - np.log(len(own)) - VALUE_COST
    place = int(np.argmax(gain))
    return _candidate(kind, law, space, place, float(size[place]), float(gain[place]))


def _candidate(
    kind: EffectKind, law: RandomLaw, space: Workspace, place: int, variance: float, gain: float
) -> Candidate:
    pattern = law.patterns[:, place]
    reading = float(np.sqrt(np.median(np.diag(space.noise.white))))
    values = {p.name: p.typical for p in kind.parameters}
    values[kind.parameters[0].name] = law.size(variance, reading)
    spread = variance * np.outer(pattern, pattern)
    places = () if law.together else (place,)
    names = () if law.together else (law.names[place],)
    if law.walk:
        return Candidate(kind, places, names, values, gain, walk=spread)
    return Candidate(kind, places, names, values, gain, white=np.diag(spread).copy(), noisy=True)
