"""How often a healthy BPM repeats its reading, learnt BPM by BPM.

A reading with a last digit as large as its noise repeats itself by chance. Such a BPM is frozen
only when it repeats itself longer than it would by chance. A run of repeats teaches when it has
ended, as a BPM that is dead ends none; and it teaches no more than the run from which the BPM
counted as frozen, so that a BPM that hangs now and then is not taken for a coarse one.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Mask, Vector

CHANCE = 3e-9
"""Chance of a run that is none: once a day at 10 Hz among 360 BPMs, 1 / (360 · 10 · 86 400)."""

BEFORE = 20.0
"""Changes of which each BPM is thought to have made one: a single repeat at the start of a loop
then stands for a chance of 1/21, not of 1."""

KEPT = 0.999
"""Share of what is known that a change leaves: 1,000 changes are remembered, 100 s at 10 Hz."""

LONGEST = 300
"""Repeats from which a BPM is frozen whatever its habit: 30 s at 10 Hz."""


@dataclass(frozen=True, slots=True)
class Habit:
    """What is known of each BPM.

    Args:
        repeats: Repeats in runs that have ended, shape (n,).
        changes: Runs that have ended, shape (n,).
    """

    repeats: Vector
    changes: Vector

    @classmethod
    def none(cls, size: int) -> "Habit":
        """Know nothing of n BPMs."""
        return cls(np.zeros(size), np.zeros(size))

    def frozen_from(self, least: int) -> NDArray[np.int64]:
        """Give the repeats in a row from which each BPM is frozen, shape (n,).

        Args:
            least: For a BPM that never repeats itself.
        """
        share = self.repeats / (self.repeats + self.changes + BEFORE)
        usual = np.zeros(len(share))
        some = share > 0
        usual[some] = np.ceil(np.log(CHANCE) / np.log(share[some]))
        return np.clip(usual, least, max(LONGEST, least)).astype(np.int64)

    def learn(self, changed: Mask, run: NDArray[np.int64], frozen: NDArray[np.int64]) -> "Habit":
        """Take in the runs that have ended.

        Args:
            changed: BPMs whose reading is a new one, shape (n,).
            run: Repeats in a row before this reading, shape (n,).
            frozen: From which each counted as frozen, shape (n,).
        """
        kept = np.where(changed, KEPT, 1.0)
        repeats = kept * self.repeats + np.where(changed, np.minimum(run, frozen), 0)
        return Habit(repeats, kept * self.changes + changed)
