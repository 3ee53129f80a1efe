"""The variances of orbits that walk at random and are read with noise, if R is known."""

import math

import numpy as np

from orbitfb.core.signals import Vector

_EXACT = 1e-12
"""How near the variances at rest are, relative to the noise, where they are taken for them [1]."""


class OrbitFilter:
    """The Riccati recursion of every mode and group: p ← p + q, p ← p r² / (p + r²).

    It owes nothing to what is read, and where readings and changes take turns it comes to rest:
    its distance from there falls by (1 − L)² at every tick, L the smallest gain at rest. From then
    on nothing is computed.

    Args:
        steps: q, variance of the random step of each, shape (j,) [m²].
        noise: r², variance of the reading noise [m²].
    """

    def __init__(self, steps: Vector, noise: float) -> None:
        self._steps, self._noise = steps, noise
        rest = at_rest(steps, noise)
        shares = noise / (rest + noise)
        self._resting = rest, rest * shares, (rest + noise, shares)
        slowest = 2.0 * math.log(float(np.max(shares)))
        self._ticks = math.ceil(math.log(_EXACT) / slowest) if slowest < 0.0 else math.inf
        self._turns, self._just_read = 0, False
        self.variances = np.zeros(len(steps))

    def forget(self, variance: float) -> None:
        """Know of every orbit only that its variance is this one [m²]."""
        self.variances = np.full(len(self._steps), variance)
        self._turns = 0

    def predict(self) -> None:
        """Go on by a tick."""
        self._turns = self._turns + 1 if self._just_read else 0
        self._just_read = False
        if self._turns > self._ticks:
            self.variances = self._resting[0]
        else:
            self.variances = self.variances + self._steps

    def weigh(self) -> tuple[Vector, Vector]:
        """Give the variances of the innovations of a reading [m²] and the shares r² of them [1].

        Each has shape (j,); nobody may write into it.
        """
        if self._turns > self._ticks and not self._just_read:
            return self._resting[2]
        variances = self.variances + self._noise
        return variances, self._noise / variances

    def update(self) -> None:
        """Take in a reading."""
        if self._turns > self._ticks and not self._just_read:
            self.variances = self._resting[1]
        else:
            self.variances = self.variances * self.weigh()[1]
            self._turns = 0 if self._just_read else self._turns
        self._just_read = True


def at_rest(steps: Vector, noise: float) -> Vector:
    """Give the variance of the predicted orbit at rest.

    Args:
        steps: Of the random step, shape (j,) [m²].
        noise: Of the readings [m²].
    """
    ratio = steps / noise
    return 0.5 * noise * (ratio + np.sqrt(ratio * (ratio + 4.0)))
