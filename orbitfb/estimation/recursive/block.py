"""What was changed and what was read in a block of ticks, for `recursive.coefficients`."""

import numpy as np

from orbitfb.core.signals import Vector


class Block:
    """The rows of a regression of the innovations on what R was mistaken in.

    What the orbit is mistaken in at a tick is a sum of what it was mistaken in when the block
    began and of what R was mistaken in times the changes since; a reading takes its share of both.

    Args:
        coefficients: k of a mode; a regressor is a change, and 1 for the last of them.
        length: Most changes of a block.

    Attributes:
        readings: How many there are.
    """

    def __init__(self, coefficients: int, length: int) -> None:
        self._changes = np.ones((length, coefficients))
        self._innovations: list[Vector] = []
        self._variances: list[Vector] = []
        self._shares: list[Vector] = []
        self._before: list[int] = [0]
        self.readings = 0

    @property
    def is_empty(self) -> bool:
        """Whether nothing was changed and nothing read."""
        return self.readings == 0 and len(self._before) == 1

    @property
    def changes(self) -> Vector:
        """The regressors u, shape (j, k)."""
        return self._changes[: len(self._before) - 1]

    @property
    def innovations(self) -> Vector:
        """What the readings are beyond what was expected, shape (b, n) [m]."""
        return np.array(self._innovations)

    @property
    def variances(self) -> Vector:
        """Of these, if R is known, of every mode and of every group, (b, n + groups) [m²]."""
        return np.array(self._variances)

    def weights(self, groups: int) -> Vector:
        """Give the parts of δx and of every change in every reading, and in the orbit now.

        Args:
            groups: How many there are.

        Returns:
            Shape (groups, b + 1, 1 + j) [1]; the last row is for the orbit after all of it.
        """
        fallen = np.zeros((groups, self.readings + 1))
        if self.readings:
            np.cumsum(np.log(np.array(self._shares)).T, axis=1, out=fallen[:, 1:])
        before = np.array(self._before)
        parts = fallen[:, :, None] - fallen[:, before][:, None, :]
        later = np.arange(self.readings + 1)[:, None] >= before
        return np.where(later, np.exp(np.minimum(parts, 0.0)), 0.0)

    def begin(self) -> None:
        """Begin anew."""
        self.readings = 0
        del self._before[1:]
        self._innovations.clear()
        self._variances.clear()
        self._shares.clear()

    def next(self) -> Vector:
        """Give the regressor of a change, shape (k,), to be filled in; at most `length` of them."""
        self._before.append(self.readings)
        return self._changes[len(self._before) - 2]

    def read(self, innovations: Vector, variances: Vector, shares: Vector) -> None:
        """Take in a reading; the arrays are kept, nobody may write into them.

        Args:
            innovations: Shape (n,) [m].
            variances: Theirs if R is known, of every mode and of every group, (n + groups,) [m²].
            shares: r² over them, of every group, shape (groups,) [1].
        """
        self._innovations.append(innovations)
        self._variances.append(variances)
        self._shares.append(shares)
        self.readings += 1
