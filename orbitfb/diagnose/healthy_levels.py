"""Healthy BPMs differ in noise: how loud one is tells little of the gain of its readings.

What scales the readings of a BPM scales their noise, and of a long record the level of the noise
is known to a per cent; but not what it should be. It is a nuisance of its own, normal about the
usual one: at its most likely value it goes along with whatever a cause makes of the noise.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.effects.device_kinds import SensorKind
from orbitfb.effects.record import Record
from orbitfb.physics.optics import Matrix

WITHIN, BETWEEN = 0.05, 0.1
"""Scatter of the logarithm of a healthy variance between times of a record, and between records."""
_STEPS = 60


@dataclass(frozen=True, slots=True, eq=False)
class HealthyLevels:
    """Levels of the noise of the BPMs whose readings a cause scales.

    Args:
        rows: Since it acts, shape (N,).
        axes: These BPMs in the modes, shape (k, n).
        scatter: Standard deviation of the logarithm of a healthy level.
    """

    rows: Mask
    axes: Matrix
    scatter: float

    @classmethod
    def of(
        cls, record: Record, floor: NoiseFloor, causes: Sequence[Cause]
    ) -> "list[HealthyLevels]":
        """Those of all causes that scale noise.

        Args:
            record: What happened.
            floor: The noise.
            causes: Put into the model.
        """
        found: list[HealthyLevels] = []
        for cause in causes:
            rows = ~record.starts
            rows[: cause.onset] = False
            if isinstance(cause.kind, SensorKind) and cause.kind.scales and rows.any():
                scatter = WITHIN if cause.onset else max(BETWEEN, floor.modes.scatter)
                found.append(cls(rows, floor.modes.axes[list(cause.places)], 0.5 * scatter))
        return found

    def likeliest(self, before: Callable[[], Matrix], left: Matrix) -> tuple[Matrix, Vector]:
        """Take the levels at their most likely values.

        Args:
            before: Gives white innovations without the cause, shape (N, n).
            left: The same with it, shape (N, n).

        Returns:
            `left` at these levels; and what that adds to the log-Jacobian, beyond what levels
            would gain without the cause, shape (N,) [nats].
        """
        noise, count = left[self.rows] @ self.axes.T, int(self.rows.sum())
        usual = np.sum((before()[self.rows] @ self.axes.T) ** 2, axis=0)
        level, known = self._level(np.sum(noise**2, axis=0), count), self._level(usual, count)
        spared = -0.5 * usual * np.expm1(-2.0 * known) - count * known - self._unlikely(known)
        left, owed = left.copy(), np.zeros(len(left))
        left[self.rows] += (noise * np.expm1(-level)) @ self.axes
        owed[self.rows] = -np.sum(level + (self._unlikely(level) + spared) / count)
        return left, owed

    def following(self, left: Matrix, change: Matrix) -> tuple[Matrix, Vector]:
        """Let the levels go along with a small change.

        Args:
            left: White innovations, shape (N, n).
            change: Of them, shape (N, n).

        Returns:
            What is left of the change, and what the levels add to the log-Jacobian, (N,) [nats].
        """
        noise, moved = left[self.rows] @ self.axes.T, change[self.rows] @ self.axes.T
        squares, count = np.sum(noise**2, axis=0), int(self.rows.sum())
        certain = self.scatter**-2 / (2.0 * count + self.scatter**-2)
        level = (1.0 - certain) * np.sum(noise * moved, axis=0) / np.maximum(squares, 1e-300)
        change, owed = change.copy(), np.zeros(len(left))
        change[self.rows] -= (noise * level) @ self.axes
        owed[self.rows] = -float(np.sum(level))
        return change, owed

    def _unlikely(self, level: Vector) -> Vector:
        return 0.5 * (level / self.scatter) ** 2

    def _level(self, squares: Vector, count: int) -> Vector:
        """The root of Σ e² exp(−2 x) − N − x / σ² by Newton's steps, shape (k,).

        It is convex and falls: from the left of its root they go up to that.
        """
        ratio = np.maximum(squares / count, np.finfo(float).tiny)
        level = np.minimum(0.5 * np.log(ratio), 0.0)
        for _ in range(_STEPS):
            now = squares * np.exp(-2.0 * level)
            slope = 2.0 * now + self.scatter**-2
            level = level + (now - count - level / self.scatter**2) / slope
        return level
