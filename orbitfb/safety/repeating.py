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
"""Readings for which what all BPMs do stands with each: a single repeat at the start of a loop then
stands for a chance of 1/21, not of 1. BPMs of one kind know each other's last digit: each of them
alone takes 10 s to learn it, and meanwhile too many are left out for a loop to close."""

COARSE = 0.01
"""Share of repeats, which is also about the chance of one certain value at a quiet orbit, from
which a reading of exactly 0 is a number like any other. If it were none, such a BPM would be left
out for it and the five readings of its proving, 6 % of the time: more than may be at once."""

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

    @property
    def usual(self) -> float:
        """Share of readings at which any BPM repeats itself."""
        return float(self.repeats.sum() / (self.repeats.sum() + self.changes.sum() + BEFORE))

    @property
    def share(self) -> Vector:
        """Share of its readings at which each BPM repeats itself, shape (n,)."""
        return (self.repeats + BEFORE * self.usual) / (self.repeats + self.changes + BEFORE)

    @property
    def is_coarse(self) -> Mask:
        """Whether the last digit of each is so large that it reads exactly 0 by chance, (n,).

        One that repeats itself alone among all is rather one that has hung.
        """
        return (self.share >= COARSE) & (self.usual >= COARSE)

    def frozen_from(self, least: int) -> NDArray[np.int64]:
        """Give the repeats in a row from which each BPM is frozen, shape (n,).

        Args:
            least: For a BPM that never repeats itself.
        """
        share = self.share
        usual = np.zeros(len(share))
        some = share > 0
        usual[some] = np.ceil(np.log(CHANCE) / np.log(share[some]))
        return np.clip(usual, least, max(LONGEST, least)).astype(np.int64)

    def learn(
        self, changed: Mask, run: NDArray[np.int64], frozen: NDArray[np.int64] | int
    ) -> "Habit":
        """Take in the runs that have ended.

        Args:
            changed: BPMs whose reading is a new one, shape (n,).
            run: Repeats in a row before this reading, shape (n,).
            frozen: From which each counted as frozen, shape (n,), or all of them.
        """
        kept = np.where(changed, KEPT, 1.0)
        repeats = kept * self.repeats + np.where(changed, np.minimum(run, frozen), 0)
        return Habit(repeats, kept * self.changes + changed)
