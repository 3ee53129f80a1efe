"""What a scan proposes: a cause with the gain that it promises."""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.explain import Cause
from orbitfb.effects.kinds import EffectKind, Values

KEPT = 3
"""Candidates that every look at a kind keeps."""
LAST_ONSET = 40
FIRST_ONSET = 20
"""Rows at the ends of a record in which no onset is looked for."""
LEAST_INFORMATION = 1e-3
"""Information below which a change of typical size leaves no trace [nats]."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A cause that the scan thinks worth a fit.

    Args:
        cause: What, where, how large (roughly), since when.
        gain: Estimated gain of the log-likelihood [nats].
        choices: Among how many places and onsets it was chosen.
        group: Name of the group of devices that it strikes; empty for single ones.
        alone: The gain if no healthy device scattered about its kin [nats]; None: the same.
    """

    cause: Cause
    gain: float
    choices: float
    group: str = ""
    alone: float | None = None

    @property
    def whole(self) -> float:
        """Gain with what healthy devices scatter, which the record gains too [nats]."""
        return self.gain if self.alone is None else self.alone


def held_to(gain: Vector, deviations: Vector) -> Vector:
    """Hold gains against what healthy devices do too.

    Args:
        gain: At least 0 [nats].
        deviations: Of healthy ones, that would make the same.

    Returns:
        What is beyond them [nats].
    """
    tolerance = 0.5 * deviations**2
    return gain * tolerance / np.maximum(gain + tolerance, 1e-300)


def best_strength(kind: EffectKind, score: Vector, info: Vector) -> tuple[Vector, Vector]:
    """Best strength and its gain, of every place.

    Where the change is linear in a parameter, or in all, any strength will do that is in their
    bounds; where it is not the change itself is at stake, and the grid has others.
    """
    seen = info > LEAST_INFORMATION
    strength = np.divide(score, info, out=np.zeros_like(score), where=seen)
    if not kind.sizes:
        strength = np.ones_like(strength)
    elif all(p.low >= p.nominal for p in kind.sizes):
        strength = np.maximum(strength, 0.0)
    return strength, np.where(seen, strength * score - 0.5 * strength**2 * info, 0.0)


def sized(kind: EffectKind, values: Values, strength: float) -> Values:
    """Parameters at which the change is `strength` times that at `values`."""
    scaled = {
        p.name: float(np.clip(p.nominal + strength * (values[p.name] - p.nominal), p.low, p.high))
        for p in kind.sizes
    }
    return {**values, **scaled}
