"""Whiten small orbits in single precision: what is searched by it is judged in double."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Mask
from orbitfb.diagnose.innovation import NoiseFloor, stretches
from orbitfb.diagnose.recursion import Feedback
from orbitfb.diagnose.uncoupled import Product

Single = NDArray[np.float32]


class Quick:
    """A noise floor in single precision.

    Args:
        floor: In double precision.
        starts: Where stretches begin, shape (N,).
        modes: Its modes as blocks; split anew when None.
    """

    def __init__(self, floor: NoiseFloor, starts: Mask, modes: Product | None = None) -> None:
        self.floor = floor
        self.modes = Product.of(floor.modes.directions) if modes is None else modes
        self._starts = starts
        self._stretches = stretches(starts)
        self._longest = max((one.stop - one.start for one in self._stretches), default=0)

    @cached_property
    def _feedback(self) -> Feedback:
        return Feedback.of(self.floor.feedback_of(self._longest), np.float32)

    @cached_property
    def _inverse(self) -> Single:
        return (1.0 / self.floor.deviation_of(self._longest)).astype(np.float32)

    def whiten(self, left: Single) -> Single:
        """Turn an orbit (N, n) [m] into innovations of unit variance, in the modes, (N, n)."""
        return self.whiten_modes(self.modes.right(left))

    def whiten_modes(self, z: Single) -> Single:
        """As `whiten`, of an orbit in the modes, (N, n)."""
        steps = np.zeros_like(z)
        np.subtract(z[1:], z[:-1], out=steps[1:])
        return self.follow(steps)

    def follow(self, steps: Single) -> Single:
        """As `whiten_modes`, of the changes of an orbit from the row before, (N, n), in place."""
        steps[self._starts] = 0.0
        for own in self._stretches:
            piece = steps[own]
            self._feedback.forward(piece)
            piece *= self._inverse[: len(piece)]
        return steps

    def adjoint(self, white: Single) -> Single:
        """Give the derivative of Σ ½ white² … by the predictions, as `NoiseFloor.adjoint`."""
        total = np.zeros_like(white)
        for own in self._stretches:
            piece = white[own] * self._inverse[: own.stop - own.start]
            piece[0] = 0.0
            self._feedback.backward(piece)
            piece[0] = 0.0
            total[own] = piece
            total[own.start : own.stop - 1] -= piece[1:]
        return self.modes.back(total)
