"""Normal equations of a response that is linear in row, column and rank-one terms.

    residual_ij = Σ_r pattern_ij θ_row(i) + Σ_c pattern_ij θ_column(j) + Σ_q left_iq right_qj θ_q

with weights u_i v_j where an element is kept. A gradient is an outer product over the matrix, so
Σ_ij over all elements is a product of two small sums; only what is left out costs extra.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

_CHUNK = 4096
"""Left-out elements that are summed at once; only memory depends on it."""


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """One block of the linear problem.

    Args:
        residual: Measured less model, shape (n, m) [m/rad]; finite where kept.
        kept: Elements that count, shape (n, m).
        row_weight: u, shape (n,).
        column_weight: v, shape (m,); u v is in [rad²/m²].
        rows: Patterns (n, m) and parameters (n,) that belong to a row.
        columns: Patterns (n, m) and parameters (m,) that belong to a column.
        left: Shape (n, q).
        right: Shape (q, m).
        gradients: Parameters of the rank-one terms, shape (q,).
    """

    residual: Matrix
    kept: Mask
    row_weight: Vector
    column_weight: Vector
    rows: Sequence[tuple[Matrix, Indices]]
    columns: Sequence[tuple[Matrix, Indices]]
    left: Matrix
    right: Matrix
    gradients: Indices

    @property
    def weight(self) -> Matrix:
        """Weight of every element, shape (n, m)."""
        return np.where(self.kept, np.outer(self.row_weight, self.column_weight), 0.0)


def normal_equations(pieces: Sequence[Piece], size: int) -> tuple[Matrix, Vector]:
    """Sum the normal equations of some blocks.

    Args:
        pieces: The blocks.
        size: Number of parameters k.

    Returns:
        H, shape (k, k), and b, shape (k,), of ½ θᵀHθ − bᵀθ.
    """
    matrix, pull = np.zeros((size, size)), np.zeros(size)
    for piece in pieces:
        _add(piece, matrix, pull)
    return matrix, pull


def _add(piece: Piece, matrix: Matrix, pull: Vector) -> None:
    weight = piece.weight
    weighted = weight * np.where(piece.kept, piece.residual, 0.0)
    own: list[tuple[Indices, Indices, Matrix]] = []
    for pattern, index in piece.rows:
        np.add.at(pull, index, np.sum(weighted * pattern, axis=1))
    for pattern, index in piece.columns:
        np.add.at(pull, index, np.sum(weighted * pattern, axis=0))
    for number, (pattern, index) in enumerate(piece.rows):
        for other, its in piece.rows[number:]:
            _diagonal(
                matrix, index, its, np.sum(weight * pattern * other, axis=1), other is pattern
            )
        for other, its in piece.columns:
            own.append((index, its, weight * pattern * other))
        if len(piece.gradients):
            own.append((index, piece.gradients, piece.left * ((weight * pattern) @ piece.right.T)))
    for number, (pattern, index) in enumerate(piece.columns):
        for other, its in piece.columns[number:]:
            _diagonal(
                matrix, index, its, np.sum(weight * pattern * other, axis=0), other is pattern
            )
        if len(piece.gradients):
            seen = ((weight * pattern).T @ piece.left) * piece.right.T
            own.append((index, piece.gradients, seen))
    for first, second, values in own:
        matrix[np.ix_(first, second)] += values
        matrix[np.ix_(second, first)] += values.T
    if len(piece.gradients):
        index = piece.gradients
        pull[index] += np.sum(piece.left * (weighted @ piece.right.T), axis=0)
        matrix[np.ix_(index, index)] += _gradients(piece)


def _diagonal(matrix: Matrix, first: Indices, second: Indices, values: Vector, same: bool) -> None:
    matrix[first, second] += values
    if not same:
        matrix[second, first] += values


def _gradients(piece: Piece) -> Matrix:
    u, v, left, right = piece.row_weight, piece.column_weight, piece.left, piece.right
    total = ((left.T * u) @ left) * ((right * v) @ right.T)
    rows, columns = np.nonzero(~piece.kept & (np.outer(u, v) > 0.0))
    for begin in range(0, len(rows), _CHUNK):
        some = slice(begin, begin + _CHUNK)
        absent = left[rows[some]] * right[:, columns[some]].T
        absent *= np.sqrt(u[rows[some]] * v[columns[some]])[:, None]
        total -= absent.T @ absent
    return total
