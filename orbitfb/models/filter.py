"""The prediction-error prefilter: make the noise of orbit differences white, mode by mode.

With the orbit x_{n+1} = x_n + R a_n + w_n and the reading y_n = x_n + v_n (w, v white), the
difference d_n = y_{n+1} − y_n − R a_n is a moving average of order one. Its innovations are

    e_{n+1} = (1 − L_n) e_n + d_n,

L the Kalman gain of a mode. Because the filter is linear, innovations are a *regression*:
the same filter on a_n gives the regressor φ, the same filter on y_{n+1} − y_n the response,
and e = filtered difference − R φ (Ljung, System Identification, ch. 7). The naive regression
of y_{n+1} − y_n on a_n leaves v_n on both sides, this one does not.

A stretch of data begins with a diffuse orbit: L starts at 1 and falls to its steady value.
"""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Mask, Vector

_BLOCK = 64
_AGES = 400


def innovation_ratio(gains: Vector) -> Vector:
    """Variance of the innovation over that of the reading noise, 1 / (1 − L)."""
    return 1.0 / (1.0 - gains)


def ground_ratio(gains: Vector) -> Vector:
    """Variance of the orbit's step over that of the reading noise, L² / (1 − L)."""
    return gains**2 / (1.0 - gains)


@dataclass(frozen=True, slots=True)
class Carry:
    """Where a filter stands between two blocks of rows.

    Args:
        columns: Last filtered row for every gain, shape (G, k).
        age: Rows since the stretch began; 0 when the next row begins one.
    """

    columns: Vector
    age: int


class PrefilterBank:
    """First-order filters 1 / (1 − (1 − L) z⁻¹), one for each Kalman gain of a ladder.

    Args:
        gains: Steady Kalman gains, shape (G,), each in (0, 1).
    """

    def __init__(self, gains: Vector) -> None:
        self.gains = gains
        step = ground_ratio(gains)
        feedback = np.empty((_AGES, len(gains)))
        weight = np.empty((_AGES, len(gains)))
        variance = np.ones(len(gains))
        feedback[0] = 0.0
        for age in range(_AGES):
            predicted = variance + step
            weight[age] = np.sqrt(innovation_ratio(gains) / (predicted + 1.0))
            gain = predicted / (predicted + 1.0)
            if age + 1 < _AGES:
                feedback[age + 1] = 1.0 - gain
            variance = gain
        self._feedback = feedback
        self._weight = weight

    def start(self, columns: int) -> Carry:
        """Begin before any data; `columns` is the width of the rows."""
        return Carry(np.zeros((len(self.gains), columns)), 0)

    def run(self, rows: Vector, starts: Mask, carry: Carry) -> tuple[Vector, Vector, Carry]:
        """Filter a block of rows.

        Args:
            rows: Shape (T, k).
            starts: Whether a row begins a stretch, shape (T,).
            carry: Where the filter stood before the block.

        Returns:
            Filtered rows, shape (G, T, k); factors that give every innovation of a stretch's
            beginning the variance of the steady ones, shape (G, T); and the new carry.
        """
        ages = _ages(starts, carry.age)
        capped = np.minimum(ages, _AGES - 1)
        feedback = self._feedback[capped]
        filtered = np.empty((len(self.gains), *rows.shape))
        columns = carry.columns.copy()
        for begin in range(0, len(rows), _BLOCK):
            piece = slice(begin, min(begin + _BLOCK, len(rows)))
            for level in range(len(self.gains)):
                kernel, fading = _kernel(feedback[piece, level])
                filtered[level, piece] = kernel @ rows[piece]
                filtered[level, piece] += fading[:, None] * columns[level]
                columns[level] = filtered[level, piece.stop - 1]
        age = int(ages[-1]) + 1 if len(rows) else carry.age
        return filtered, self._weight[capped].T, Carry(columns, age)


def _ages(starts: Mask, before: int) -> np.ndarray:
    """Rows since the beginning of the stretch, shape (T,)."""
    index = np.arange(len(starts))
    begin = np.maximum.accumulate(np.where(starts, index, -before))
    return index - begin


def _kernel(feedback: Vector) -> tuple[Vector, Vector]:
    """Impulse responses of one block: Π feedback over (k, n], lower triangular, and from before."""
    size = len(feedback)
    cut = feedback == 0.0
    segment = np.cumsum(cut)
    logarithm = np.cumsum(np.log(np.where(cut, 1.0, feedback)))
    kernel = np.tril(np.exp(np.minimum(logarithm[:, None] - logarithm[None, :], 0.0)))
    kernel *= segment[:, None] == segment[None, :]
    fading = np.exp(logarithm) * (segment == 0)
    return kernel.reshape(size, size), fading
