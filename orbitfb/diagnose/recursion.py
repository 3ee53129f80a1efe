"""First-order recursions over the rows of a record, many rows at a time.

x_k = s_k + f_k x_{k−1} is linear, so that blocks of rows can all be begun from nothing at once;
what a block would have had from the one before it is its carry times the product of the f since.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orbitfb.physics.optics import Matrix

_ROWS = 32
"""Rows of a block."""

_Array = NDArray[np.floating]


@dataclass(frozen=True, slots=True, eq=False)
class Feedback:
    """What every row passes on, prepared for whole blocks of rows.

    Args:
        each: f by which the row before counts in a row, shape (N, n); that of row 0 does not count.
        since: Product of f from the first row of its block on, shape (N, n).
        until: Product of the f of the rows after it within its block and the first of the next
            one, shape (N, n).
    """

    each: _Array
    since: _Array
    until: _Array

    @classmethod
    def of(cls, each: Matrix, precision: type[np.floating] = np.float64) -> "Feedback":
        """Prepare.

        Args:
            each: As above.
            precision: Of the numbers.
        """
        rows, width = each.shape
        blocks = -(-rows // _ROWS)
        padded = np.zeros((blocks * _ROWS + 1, width))
        padded[:rows] = each
        padded[0] = 0.0
        since = np.cumprod(padded[:-1].reshape(blocks, _ROWS, width), axis=1)
        after = padded[1:].reshape(blocks, _ROWS, width)
        until = np.cumprod(after[:, ::-1], axis=1)[:, ::-1]
        least = np.finfo(precision).tiny
        kept = [np.where(one < least, 0.0, one) for one in (padded[:-1], since, until)]
        return cls(
            *(np.ascontiguousarray(one.reshape(-1, width)[:rows], dtype=precision) for one in kept)
        )

    def forward(self, steps: _Array) -> None:
        """Turn s into x in place: x_k = s_k + f_k x_{k−1}.

        Args:
            steps: Contiguous, of as many rows as wanted from the first on, shape (≤ N, n).
        """
        rows = len(steps)
        blocks = rows // _ROWS
        whole = blocks * _ROWS
        if blocks:
            x, f = _blocks(steps, blocks), _blocks(self.each, blocks)
            for row in range(1, _ROWS):
                x[:, row] += f[:, row] * x[:, row - 1]
            since = _blocks(self.since, blocks)
            carries = np.empty_like(x[:, 0])
            carries[0] = 0.0
            for block in range(1, blocks):
                carries[block] = x[block - 1, -1] + since[block - 1, -1] * carries[block - 1]
            x[1:] += since[1:] * carries[1:, None]
        for row in range(max(whole, 1), rows):
            steps[row] += self.each[row] * steps[row - 1]

    def backward(self, steps: _Array) -> None:
        """Turn s into x in place: x_k = s_k + f_{k+1} x_{k+1}, from the last row to the first.

        Args:
            steps: As for `forward`.
        """
        rows = len(steps)
        blocks = rows // _ROWS
        whole = blocks * _ROWS
        for row in range(rows - 2, whole - 1, -1):
            steps[row] += self.each[row + 1] * steps[row + 1]
        if not blocks:
            return
        x, f = _blocks(steps, blocks), _blocks(self.each, blocks)
        for row in range(_ROWS - 2, -1, -1):
            x[:, row] += f[:, row + 1] * x[:, row + 1]
        until = _blocks(self.until, blocks)
        carries = np.zeros_like(x[:, 0])
        if whole < rows:
            carries[-1] = steps[whole]
        for block in range(blocks - 2, -1, -1):
            carries[block] = x[block + 1, 0] + until[block + 1, 0] * carries[block + 1]
        x += until * carries[:, None]


def _blocks(rows: _Array, count: int) -> _Array:
    return rows[: count * _ROWS].reshape(count, _ROWS, -1)
