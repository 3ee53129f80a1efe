"""Feed a comparison with a fixed response block by block: the prefiltered rows it asks for."""

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.models.comparison import Comparison, Contrast
from orbitfb.models.filter import PrefilterBank
from orbitfb.models.noise import LADDER
from orbitfb.models.settings import IdentifySettings

_BLOCK = 100
"""Rows of one contrast: the alarm is at most so much late, and the filter is quick."""


class Contrasts:
    """Compares rows with one response, and goes on with another one.

    Args:
        settings: First belief about the noise, expected size of a change, memory.
    """

    def __init__(self, settings: IdentifySettings) -> None:
        self._settings = settings
        self._bank = PrefilterBank(LADDER)
        self._carry = self._bank.start(0)
        self._comparison: Comparison | None = None

    def compare_with(self, response: Vector | None) -> None:
        """Begin a comparison with another response; one that goes on keeps what it has learnt.

        Args:
            response: Rows of UᵀR, shape (n, m) [m/A]; None: with none.
        """
        before = self._comparison
        if response is None:
            self._comparison = None
        elif before is None or not np.array_equal(before.response, response):
            self._comparison = Comparison(response, self._settings, before)
            if before is None:
                self._carry = self._bank.start(sum(response.shape))

    def absorb(self, changes: Vector, differences: Vector, starts: Mask) -> tuple[Contrast, ...]:
        """Take in rows.

        Args:
            changes: Shape (T, m) [A].
            differences: In modes, shape (T, n) [m].
            starts: Whether a row does not continue the one before it, shape (T,).
        """
        if self._comparison is None:
            return ()
        both = np.concatenate([changes, differences], axis=1)
        columns = changes.shape[1]
        found: list[Contrast] = []
        for begin in range(0, len(both), _BLOCK):
            piece = slice(begin, begin + _BLOCK)
            filtered, weights, self._carry = self._bank.run(both[piece], starts[piece], self._carry)
            filtered *= weights[:, :, None]
            found.append(
                self._comparison.absorb(filtered[:, :, :columns], filtered[:, :, columns:])
            )
        return tuple(found)
