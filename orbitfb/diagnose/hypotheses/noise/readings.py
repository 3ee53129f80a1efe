"""The noise of single readings, and laws of it that some BPMs have or all."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.estimation.maxima import nearby
from orbitfb.estimation.priors import MORE
from orbitfb.estimation.transform import Matrix

_STEP = 1.9
"""Factor by which a value may lie beside the one that was scanned. By hand: the next one is a
factor of two away, or less."""


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


def all_or_some(gain: Vector) -> tuple[float, tuple[int, ...]]:
    """Evidence of all BPMs, or of those that have it beyond what choosing them costs."""
    cost = float(np.log(len(gain)))
    chosen = np.flatnonzero(gain > cost + MORE)
    some = float(np.sum(gain[chosen] - cost)) if len(chosen) else -np.inf
    every = float(np.sum(gain))
    if every >= some:
        return every, ()
    return some, tuple(int(place) for place in chosen)


def told_finely(one: Candidate, worth: Callable[[float], float]) -> Candidate:
    """A candidate of a grid whose level is told between the values of the grid if it leads."""
    ((name, value),) = one.values.items()

    def finer() -> Candidate:
        best, spread = nearby(worth, value, _STEP)
        more = max(worth(best) - worth(value), 0.0)
        return replace(
            one, values={name: best}, evidence=one.evidence + more, deviations={name: spread},
            finer=None,
        )  # fmt: skip

    return replace(one, finer=finer)
