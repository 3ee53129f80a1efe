"""Healthy BPMs differ in noise: how loud one is tells little of what is done to its readings.

What scales or filters the readings of a BPM changes their noise, and of a long record the level of
that is known to a per cent; but not what it should be. It is a nuisance of its own, normal about
the usual one: at its most likely value it goes along with whatever a cause makes of the noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.effects.device_kinds import SensorKind
from orbitfb.physics.optics import Matrix
from orbitfb.records.record import Record

WITHIN, BETWEEN = 0.05, 0.1
"""Scatter of the logarithm of a healthy variance between times of a record, and between records."""
_STEPS = 60


@dataclass(frozen=True, slots=True, eq=False)
class HealthyLevels:
    """Levels of the noise of the BPMs whose readings a cause scales or filters.

    Args:
        rows: Since it acts, shape (N,).
        axes: These BPMs in the modes, shape (k, n).
        usual: Logarithm of the level of the middle BPM, over that of the floor.
        scatter: Standard deviation of the logarithm of a healthy level.
    """

    rows: Mask
    axes: Matrix
    usual: float
    scatter: float

    @classmethod
    def of(
        cls, record: Record, floor: NoiseFloor, causes: Sequence[Cause], white: Matrix
    ) -> "list[HealthyLevels]":
        """Those of all causes that change noise.

        Args:
            record: What happened.
            floor: The noise.
            causes: Put into the model.
            white: Innovations without them, shape (N, n).
        """
        found: list[HealthyLevels] = []
        for cause in causes:
            kind = cause.kind
            if not (isinstance(kind, SensorKind) and (kind.scales or kind.colours)):
                continue
            rows = _told(record, cause.onset, kind.unread(cause.values))
            if rows.any():
                scatter = WITHIN if cause.onset else max(BETWEEN, floor.modes.scatter)
                axes = floor.modes.axes
                squares = np.mean((white[~record.starts] @ axes.T) ** 2, axis=0)
                usual = 0.5 * float(np.log(max(np.median(squares), np.finfo(float).tiny)))
                found.append(cls(rows, axes[list(cause.places)], usual, 0.5 * scatter))
        return found

    def likeliest(self, before: Matrix, left: Matrix) -> tuple[Matrix, Vector]:
        """Take the levels at their most likely values.

        Args:
            before: White innovations without the cause, shape (N, n).
            left: The same with it, shape (N, n).

        Returns:
            `left` over these levels; and what belongs to the log-Jacobian, beyond what levels
            would gain without the cause, shape (N,) [nats].
        """
        noise, without = self._noise(left), self._noise(before) ** 2
        count, squares, usual = len(noise), np.sum(noise**2, axis=0), np.sum(without, axis=0)
        level, known = self._level(squares, count), self._level(usual, count)
        gained = self._gain(squares, level, count) - self._gain(usual, known, count)
        scale, quiet = np.exp(-level), np.exp(-2.0 * known)
        left, owed = left.copy(), np.zeros(len(left))
        left[self.rows] += (noise * (scale - 1.0)) @ self.axes
        # Row by row both are compared at their own levels.
        owed[self.rows] = float(np.sum(gained + 0.5 * (squares * scale**2 - usual * quiet))) / count
        owed[self.rows] -= 0.5 * without @ (1.0 - quiet)
        return left, owed

    def granted(self, before: Matrix, left: Matrix) -> float:
        """What levels gain without the cause over those of the floor, beyond what they do with it.

        How loud a healthy BPM is they tell either way [nats].

        Args:
            before: White innovations without the cause, shape (N, n).
            left: Over their levels with it, as `likeliest` gives them, shape (N, n).
        """
        count = int(self.rows.sum())
        over = np.sum(self._noise(left) ** 2, axis=0)
        level = self.usual + self.scatter**2 * (over - count)  # at its most likely value
        without = np.sum(self._noise(before) ** 2, axis=0)
        return self._free(without, count) - self._free(over * np.exp(2.0 * level), count)

    def following(self, left: Matrix, change: Matrix) -> tuple[Matrix, Vector]:
        """Let the levels go along with a small change.

        Args:
            left: White innovations with the cause, the levels not in them yet, shape (N, n).
            change: Of these, shape (N, n).

        Returns:
            What is left of the change, and what the levels add to the log-Jacobian, (N,) [nats].
        """
        noise, moved = self._noise(left), self._noise(change)
        count = len(noise)
        scale = np.exp(-self._level(np.sum(noise**2, axis=0), count))
        noise, seen = noise * scale, moved * scale
        squares, pull = np.sum(noise**2, axis=0), np.sum(noise * seen, axis=0)
        more = 2.0 * pull / (2.0 * squares + self.scatter**-2)
        change, owed = change.copy(), np.zeros(len(left))
        change[self.rows] += (seen - moved - noise * more) @ self.axes
        owed[self.rows] = -float(np.sum(squares * more)) / count
        return change, owed

    def _noise(self, white: Matrix) -> Matrix:
        """What these BPMs have of innovations since the cause acts, shape (rows, k)."""
        return white[self.rows] @ self.axes.T

    def _free(self, squares: Vector, count: int) -> float:
        level = self._level(squares, count)
        return float(np.sum(self._gain(squares, level, count) + 0.5 * squares))

    def _gain(self, squares: Vector, level: Vector, count: int) -> Vector:
        """Log-likelihood at a level, shape (k,)."""
        return -0.5 * squares * np.exp(-2.0 * level) - count * level - self._unlikely(level)

    def _unlikely(self, level: Vector) -> Vector:
        return 0.5 * ((level - self.usual) / self.scatter) ** 2

    def _level(self, squares: Vector, count: int) -> Vector:
        """The root of Σ e² exp(−2 x) − N − (x − u) / σ² by Newton's steps, shape (k,).

        It is convex and falls: from the left of its root they go up to that.
        """
        ratio = np.maximum(squares / count, np.finfo(float).tiny)
        level = np.minimum(0.5 * np.log(ratio), self.usual)
        for _ in range(_STEPS):
            now = squares * np.exp(-2.0 * level)
            slope = 2.0 * now + self.scatter**-2
            level = level + (now - count - (level - self.usual) / self.scatter**2) / slope
        return level


def _told(record: Record, onset: int, unread: int) -> Mask:
    """Rows that tell the noise from an onset on: no first ones, nor those of no use, (N,)."""
    rows = ~record.starts
    rows[:onset] = False
    for piece in record.stretches if unread else ():
        rows[max(piece.start, onset) : max(piece.start, onset) + unread] = False
        rows[max(piece.stop - unread, piece.start) : piece.stop] = False
    return rows
