"""What was changed and what was read in a block of ticks, for `recursive.coefficients`."""

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Vector

Precise = NDArray[np.floating]
"""Numbers of the precision that the estimate is told to keep, single or double."""


class Block:
    """The rows of a regression of the innovations on what R was mistaken in.

    What the orbit is mistaken in at a tick is a sum of what it was mistaken in when the block
    began and of what R was mistaken in times the changes since; a reading takes its share of both.

    Args:
        coefficients: k of a mode; a regressor is a change, and 1 for the last of them.
        modes: n of them.
        groups: How many there are.
        length: Most changes of a block; it has room for one reading more.
        noise: r², variance of the reading noise [m²].
        precision: Of the changes, as a dtype.

    Attributes:
        readings: How many there are.
    """

    def __init__(
        self,
        coefficients: int,
        modes: int,
        groups: int,
        length: int,
        noise: float,
        precision: type[np.floating],
    ) -> None:
        self._modes, self._noise = modes, noise
        self._changes = np.ones((length, coefficients), dtype=precision)
        self._innovations = np.empty((length + 1, modes))
        self._variances = np.empty((length + 1, modes + groups))
        self._before: list[int] = [0]
        self._weighed: list[int] = []
        self._shares = self._weights = np.empty((groups, 0))
        self.readings = 0

    @property
    def is_empty(self) -> bool:
        """Whether nothing was changed and nothing read."""
        return self.readings == 0 and len(self._before) == 1

    @property
    def is_full(self) -> bool:
        """Whether there is no room for another reading."""
        return self.readings == len(self._innovations)

    @property
    def changes(self) -> Precise:
        """The regressors u, shape (j, k)."""
        return self._changes[: len(self._before) - 1]

    @property
    def innovations(self) -> Vector:
        """What the readings are beyond what was expected, shape (b, n) [m]."""
        return self._innovations[: self.readings]

    @property
    def variances(self) -> Vector:
        """Of these, if R is known, of every mode and of every group, (b, n + groups) [m²]."""
        return self._variances[: self.readings]

    def weights(self) -> Vector:
        """Give the parts of δx and of every change in every reading, and in the orbit now.

        Returns:
            Shape (groups, b + 1, 1 + j) [1]; the last row is for the orbit after all of it.
        """
        shares = self._noise / self.variances[:, self._modes :].T
        if self._before == self._weighed and np.array_equal(shares, self._shares):
            return self._weights  # at rest every block is like the one before
        fallen = np.zeros((len(shares), self.readings + 1))
        np.cumsum(np.log(shares), axis=1, out=fallen[:, 1:])
        before, readings = np.array(self._before), np.arange(self.readings + 1)
        parts = np.minimum(fallen[:, :, None] - fallen[:, None, before], 0.0)
        weights = np.exp(parts.astype(self._changes.dtype))  # in single precision ten times as fast
        weights *= readings[:, None] >= before
        self._weighed, self._shares = self._before.copy(), shares
        self._weights = weights.astype(np.float64)
        return self._weights

    def begin(self) -> None:
        """Begin anew."""
        self.readings = 0
        del self._before[1:]

    def next(self) -> Precise:
        """Give the regressor of a change, shape (k,), to be filled in; at most `length` of them."""
        self._before.append(self.readings)
        return self._changes[len(self._before) - 2]

    def read(self, innovations: Vector, variances: Vector) -> None:
        """Take in a reading; the arrays are copied. There must be room for it.

        Args:
            innovations: Shape (n,) [m].
            variances: Theirs if R is known, of every mode and of every group, (n + groups,) [m²].
        """
        self._innovations[self.readings] = innovations
        self._variances[self.readings] = variances
        self.readings += 1
