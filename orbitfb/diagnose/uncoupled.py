"""Split products with matrices that are blocks: two uncoupled planes are half the work."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

Index = Indices | slice
"""Rows or columns of a block, a slice where they are neighbours."""
_Array = NDArray[np.floating]


def components(matrix: Matrix) -> list[tuple[Indices, Indices]]:
    """Rows and columns of a matrix that belong together, those of zeros alone left out.

    Args:
        matrix: Shape (n, P).
    """
    rows, columns = matrix.shape
    there = csr_array(matrix != 0.0)
    first, second = there.nonzero()
    edges = csr_array(
        (np.ones(len(first), dtype=np.bool_), (first, second + rows)),
        shape=(rows + columns, rows + columns),
    )
    count, names = connected_components(edges, directed=False)
    found: list[tuple[Indices, Indices]] = []
    for name in range(count):
        members = np.flatnonzero(names == name)
        own = members[members < rows], members[members >= rows] - rows
        if len(own[0]) and len(own[1]):
            found.append(own)
    return found


def compact(members: Indices) -> Index:
    """Give neighbours as a slice, which needs no copy."""
    if len(members) and np.all(np.diff(members) == 1):
        return slice(int(members[0]), int(members[-1]) + 1)
    return members


@dataclass(frozen=True, slots=True, eq=False)
class Product:
    """A matrix as blocks beside which it is zero.

    Args:
        shape: Of the whole matrix, (n, P).
        blocks: Rows, columns and elements of every block.
    """

    shape: tuple[int, int]
    blocks: Sequence[tuple[Index, Index, _Array]]

    @classmethod
    def of(cls, matrix: Matrix, precision: type[np.floating] = np.float32) -> "Product":
        """Find the blocks.

        Args:
            matrix: Shape (n, P).
            precision: Of the products.
        """
        rows, columns = matrix.shape
        parts = components(matrix)
        if len(parts) > max(rows, columns) // 8:
            parts = [(np.arange(rows), np.arange(columns))]  # many small ones gain nothing
        blocks = [
            (compact(own), compact(its), np.ascontiguousarray(matrix[np.ix_(own, its)], precision))
            for own, its in parts
        ]
        return cls((rows, columns), blocks)

    def right(self, left: _Array) -> _Array:
        """Give left · matrix, shape (N, P) of (N, n)."""
        if len(self.blocks) == 1 and self.blocks[0][2].shape == self.shape:
            return left @ self.blocks[0][2]
        found = np.zeros((len(left), self.shape[1]), dtype=left.dtype)
        for rows, columns, block in self.blocks:
            found[:, columns] = left[:, rows] @ block
        return found

    def back(self, right: _Array) -> _Array:
        """Give right · matrixᵀ, shape (N, n) of (N, P)."""
        if len(self.blocks) == 1 and self.blocks[0][2].shape == self.shape:
            return right @ self.blocks[0][2].T
        found = np.zeros((len(right), self.shape[0]), dtype=right.dtype)
        for rows, columns, block in self.blocks:
            found[:, rows] = right[:, columns] @ block.T
        return found
