"""The most likely errors of a healthy ring beside a cause, found by few steps."""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.background import Background
from orbitfb.diagnose.free import Beyond
from orbitfb.diagnose.quick import Quick, Single
from orbitfb.physics.optics import Matrix

_MOST_STEPS = 8
_SOLVED = 0.1
"""Gain of a step of the sizes below which they are the best [nats]."""
_CONVERGENCE = 0.15
"""Most that a step of the search leaves of what there was to gain."""


@dataclass(frozen=True, slots=True, eq=False)
class Near:
    """Sizes of the errors, shape (P,), and what they change in the innovations, (N, n)."""

    sizes: Vector
    change: Single | np.float32


class HealthySearch:
    """Takes the best healthy errors out of what is left, under one floor.

    Args:
        quick: The floor.
        background: The errors, prepared for that floor.

    Attributes:
        nearby: Where searches begin: the bench's own errors, once they are remembered.
    """

    def __init__(self, quick: Quick, background: Background) -> None:
        self._quick, self._background = quick, background
        self._nothing = Near(background.nothing, np.float32(0.0))
        self.nearby = self._latest = self._nothing

    def remember(self, sizes: Vector) -> None:
        """Begin at these from now on."""
        change = self._quick.whiten(self._background.single_orbit(sizes))
        self.nearby = self._latest = Near(sizes, change)

    def healed(self, white: Matrix, beyond: Beyond) -> tuple[Matrix, Vector]:
        """Take the best errors out.

        The search begins where the bench's errors are, or those of the last search, or at none,
        whichever is best: errors that had swallowed a cause are far from those beside it.

        Args:
            white: What is left, shape (N, n).
            beyond: Takes out of innovations what is free.

        Returns:
            What is left then, and the sizes (P,).
        """
        start, best, least = self._nothing, white, float(np.vdot(white, white))
        for near in (self.nearby, self._latest):
            if near is not self._nothing and len(near.sizes):
                left = beyond(white - near.change)
                cost = float(np.vdot(left, left) + near.sizes @ near.sizes)
                if cost < least:
                    start, best, least = near, left, cost
        white, self._latest = self._descend(best, start, _SOLVED, beyond)
        return white, self._latest.sizes

    def against(
        self,
        white: Matrix,
        enough: float,
        beyond: Beyond,
        most: int = _MOST_STEPS,
        share: float = 0.0,
    ) -> tuple[Matrix, Vector]:
        """As `healed`, from none on, for a change that stands for itself.

        Args:
            white: What is left, shape (N, n).
            enough: Gain of a step below which the sizes are the best [nats].
            beyond: As for `healed`.
            most: Steps at most.
            share: Of what is still left of the change, a gain that is enough too: the errors may
                take all but a thousandth of it.
        """
        white, near = self._descend(white, self._nothing, enough, beyond, most, share)
        return white, near.sizes

    def _descend(
        self,
        white: Matrix,
        near: Near,
        enough: float,
        beyond: Beyond,
        most: int = _MOST_STEPS,
        share: float = 0.0,
    ) -> tuple[Matrix, Near]:
        """Find the best errors by preconditioned conjugate gradients.

        The ladder's information is nearly exact, so the first step is nearly the answer, except
        for changes that the record shows very well.

        Args:
            white: What is left with the errors at hand, shape (N, n).
            near: Those errors.
            enough: Gain of a step below which they are the best [nats].
            beyond: As for `healed`.
            most: Steps at most.
            share: As for `against`.
        """
        quick, background = self._quick, self._background
        sizes, moved = near.sizes, near.change
        if not len(sizes):
            return white, near

        def slope() -> Vector:
            return background.gradient(quick.adjoint(white.astype(np.float32)), sizes)

        gradient = slope()
        direction, before = np.zeros_like(sizes), 0.0
        for _ in range(most):
            step = background.step(gradient)
            promise = float(gradient @ step)
            left = float(np.vdot(white, white) + sizes @ sizes) if share else 0.0
            least = max(enough, 0.5 * share * left)
            if 0.5 * promise <= least:  # nothing to gain at all, of a change that is none
                break
            direction = step + (promise / before if before else 0.0) * direction
            before = promise
            whole = quick.whiten(background.single_orbit(direction))
            change = beyond(whole)
            length = float(gradient @ direction) / float(
                np.vdot(change, change) + direction @ direction
            )
            sizes = sizes + length * direction
            moved = moved + np.float32(length) * whole
            white = white - np.float32(length) * change
            if 0.5 * _CONVERGENCE * promise <= least:
                break  # what is left to gain would not be enough: no need to look
            gradient = slope()
        return white, Near(sizes, moved)
