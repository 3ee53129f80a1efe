"""Directions that judge nothing: what they have of the innovations is taken out."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from orbitfb.diagnose.quick import Single
from orbitfb.physics.optics import Matrix

_BLIND = 1e-6
"""Share of a direction below which others have all of it."""

Directions = NDArray[np.floating]
Innovations = TypeVar("Innovations", Matrix, Single)
Beyond = Callable[[Innovations], Innovations]
"""Takes out of innovations of unit variance, shape (N, n), what is free."""


def beyond(*bases: Directions) -> Beyond:
    """Tell how to leave out what directions have of innovations.

    Args:
        bases: Orthonormal rows, each of shape (k, N n), and orthogonal to those of the others.
    """
    known = [basis for basis in bases if len(basis)]

    def taken(white: Innovations) -> Innovations:
        if not known:
            return white
        left = white.copy()
        for basis in known:
            left.reshape(-1)[:] -= (basis @ left.reshape(-1)) @ basis
        return left

    return taken


def orthonormal(rows: Directions, among: Directions | None = None) -> Directions:
    """Turn directions into orthonormal ones, without those that others have all of.

    Args:
        rows: Shape (k, K).
        among: Orthonormal directions to which they have to be orthogonal too, shape (j, K).
    """
    basis: list[Directions] = []
    for row in rows:
        own = row.copy()
        if among is not None and len(among):
            own -= (among @ own) @ among
        for other in basis:
            own -= (own @ other) * other
        if (size := float(own @ own)) > _BLIND * float(row @ row):
            basis.append(own / np.sqrt(size))
    return np.array(basis, dtype=rows.dtype).reshape(len(basis), rows.shape[1])
