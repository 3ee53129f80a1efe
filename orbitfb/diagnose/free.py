"""Directions that judge nothing: what they have of the innovations is taken out."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from orbitfb.diagnose.quick import Single
from orbitfb.physics.optics import Matrix

_BLIND = 1e-6
"""Share of a direction below which others have all of it."""

Rows = NDArray[np.floating]
Innovations = TypeVar("Innovations", Matrix, Single)
Beyond = Callable[[Innovations], Innovations]
"""Takes out of innovations of unit variance, shape (N, n), what is free."""


class Directions(Protocol):
    """Orthonormal changes of the innovations."""

    def __len__(self) -> int:
        """How many there are."""
        ...

    def take_out(self, left: Rows) -> None:
        """Take what they have out of innovations, shape (N, n), in place."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Few:
    """A few directions, whatever they look like.

    Args:
        rows: Orthonormal, shape (k, N n).
    """

    rows: Rows

    def __len__(self) -> int:
        """How many there are."""
        return len(self.rows)

    def take_out(self, left: Rows) -> None:
        """Take what they have out of innovations, shape (N, n), in place."""
        left.reshape(-1)[:] -= (self.rows @ left.reshape(-1)) @ self.rows


def beyond(*bases: Directions) -> Beyond:
    """Tell how to leave out what directions have of innovations.

    Args:
        bases: Orthogonal to each other.
    """
    known = [basis for basis in bases if len(basis)]

    def taken(white: Innovations) -> Innovations:
        if not known:
            return white
        left = white.copy()
        for basis in known:
            basis.take_out(left)
        return left

    return taken


def orthonormal(rows: Rows) -> Rows:
    """Turn directions into orthonormal ones, without those that others before have all of.

    Args:
        rows: Shape (k, K).
    """
    basis = np.zeros_like(rows)
    count = 0
    for row in rows:
        known = basis[:count]
        own = row - (known @ row) @ known
        if (size := float(own @ own)) > _BLIND * float(row @ row):
            basis[count] = own / np.sqrt(size)
            count += 1
    return basis[:count]
