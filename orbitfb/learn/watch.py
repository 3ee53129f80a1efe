"""What follows a swap: is the orbit worse than it was, and must the former policy come back?"""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.ports import Policy
from orbitfb.core.signals import Vector
from orbitfb.core.transitions import Transitions
from orbitfb.learn.settings import LearnSettings

BASELINE = 100
"""Ticks before a swap that say what the orbit was."""

_FALLING = 0.98
"""An orbit below so much of the lowest one yet is on its way back [1]."""


@dataclass(slots=True)
class Watch:
    """A swap under observation.

    An orbit that is too large but falls is no ground to go back: something kicked it, and the new
    policy corrects it.

    Args:
        promoted: In force since the swap.
        former: In force before.
        before: Median observed orbit before, rms [m].
        next_tick: First tick that has not been looked at.
        tripped_before: Whether the loop had tripped already at the swap.
    """

    promoted: Policy
    former: Policy
    before: float
    next_tick: int
    tripped_before: bool = False
    seen: int = 0
    bad: int = 0
    lowest: float = np.inf

    def look(self, transitions: Transitions, settings: LearnSettings) -> str:
        """Look at what has happened since; say why to go back, or nothing.

        Args:
            transitions: Those since `next_tick`.
            settings: How much is too much.
        """
        limit = settings.rollback_factor * self.before
        for value in observed_rms(transitions):
            self.seen += 1
            above, falling = not value <= limit, value < _FALLING * self.lowest
            self.bad = self.bad + 1 if above and not falling else 0
            self.lowest = min(self.lowest, value) if above else np.inf
            if self.bad >= settings.rollback_ticks:
                return (
                    f"after the swap the observed orbit stayed above {limit * 1e6:.3g} µm rms "
                    f"({settings.rollback_factor:.1f} x what it was) for "
                    f"{settings.rollback_ticks} ticks"
                )
        if len(transitions):
            self.next_tick = int(transitions.tick[-1]) + 1
        return ""


def observed_rms(transitions: Transitions) -> Vector:
    """Rms of the orbit error of every closed tick, shape (T,) [m]."""
    closed = transitions.closed & transitions.valid.any(axis=1)
    error = (transitions.orbit - transitions.reference)[closed]
    valid = transitions.valid[closed]
    squares = np.where(valid, error, 0.0) ** 2
    return np.sqrt(squares.sum(axis=1) / np.maximum(valid.sum(axis=1), 1))
