"""Single readings that are struck: tails of the noise."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.noise.readings import ReadingNoise, all_or_some
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.estimation.maxima import highest_of
from orbitfb.estimation.priors import BEND, KNOWN_TO, STRENGTHS, STRUCK_SHARES, VALUE_COST
from orbitfb.estimation.transform import Matrix

_LEAST_LEVEL = 1e-6
"""Least variance of readings that are not struck, of all of them [1]: none is without noise."""
_LEVEL_TURNS = 8
"""Turns in which the level of readings that are not struck is told. By hand, for time."""
_MOST_STRUCK = 0.5
"""Largest share of the readings that are struck: of more, the others are the odd ones."""


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

    def worth(self, share: float, amplitude: float) -> float:
        """The same of all BPMs for a share and the rms of the strikes [m].

        The level of each BPM is its most likely one (A. Dempster, N. Laird, D. Rubin, J. R. Stat.
        Soc. B 39 (1977) 1).
        """
        height = (amplitude / self.rms) ** 2
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

    def spread(self, share: float, amplitude: float) -> Vector:
        """Relative standard deviations of both, each if the other is free, shape (2,)."""
        values, bent = np.log([share, amplitude]), np.zeros((2, 2))
        for one, other in product(range(2), range(2)):
            step, along = BEND * np.eye(2)[one], BEND * np.eye(2)[other]
            corners = [values + s * step + t * along for s, t in product((1, -1), (1, -1))]
            both, up, down, none = (self.worth(*np.exp(corner)) for corner in corners)
            bent[one, other] -= (both - up - down + none) / (4.0 * BEND**2)
        # Where the likelihood is flat it may bend upwards: that says nothing.
        size, modes = np.linalg.eigh(bent)
        return np.asarray(np.sqrt((modes**2) @ (1.0 / (np.maximum(size, 0.0) + 1.0 / KNOWN_TO**2))))


def scan_tails(kind: EffectKind, scorer: Scorer) -> Candidate:
    """Find single readings that are struck now and then, of all BPMs or of some."""
    tails = Tails.of(scorer)
    best: tuple[float, tuple[int, ...], float, float] = (-np.inf, (), 0.0, 0.0)
    for share, strength in product(STRUCK_SHARES, STRENGTHS):
        height = strength**2 / (1.0 + share * strength**2)
        found, places = all_or_some(tails.gain(share, height, 1.0 - share * height))
        if found > best[0]:
            best = (found, places, share, height)
    gain, places, share, height = best
    first, second = (parameter.name for parameter in kind.parameters)
    bpms = scorer.space.signals.record.layout.bpms
    told = tuple(bpms.label(place) for place in places)
    own = Tails.of(scorer, places)
    begin = {first: share, second: float(np.median(own.rms)) * float(np.sqrt(height))}
    bounds = {first: (0.0, _MOST_STRUCK), second: (0.0, np.inf)}

    def candidate(values: Values, gain: float, spread: Sequence[float] = ()) -> Candidate:
        known = dict(zip(values, spread, strict=False))
        return Candidate(
            kind, places, told, values, gain - 2 * VALUE_COST, noisy=True, deviations=known
        )

    def finer() -> Candidate:
        fine = highest_of(lambda values: own.worth(*values.values()), begin, bounds)
        more = max(own.worth(*fine.values()) - own.worth(*begin.values()), 0.0)
        return candidate(fine, gain + more, own.spread(*fine.values()).tolist())

    return replace(candidate(begin, gain), finer=finer)
