"""Readings that nothing explains: one is a kick of the orbit, several say that R is another one."""

import numpy as np

from orbitfb.estimation.recursive.coefficients import Coefficients

_MOST = 2.0
"""Kicks, less what has faded, beyond which R is taken for another one [1]. By hand."""
_FADES = 0.1
"""How much of a kick every reading that is none takes off them [1]. By hand."""
_WIDENING = 4.0
"""Factor by which such a reading widens the covariance of R [1]. By hand: its errors double."""
_WIDEST = 4.0**4
"""Variance that readings which nothing explains may give R, over that of the beginning: where they
never end, not R but the noise is another one."""


class Kicks:
    """Counts them, and widens what is not known of R where they come in a row.

    Args:
        coefficients: What is known of R, all of it learnt when a kick is counted.
    """

    def __init__(self, coefficients: Coefficients) -> None:
        self._coefficients = coefficients
        self._widest = _WIDEST * coefficients.traces()
        self._count = 0.0

    def count(self) -> None:
        """Take a reading for a kick."""
        self._count += 1.0
        if self._count > _MOST:
            most = self._widest / self._coefficients.traces()
            self._coefficients.widen(np.clip(most, 1.0, _WIDENING))

    def fade(self) -> None:
        """Take in a reading that is none."""
        self._count = max(0.0, self._count - _FADES)
