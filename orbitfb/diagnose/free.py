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


def beyond(basis: Directions) -> Beyond:
    """Tell how to leave out what orthonormal directions (k, N n) have of innovations."""

    def taken(white: Innovations) -> Innovations:
        if not len(basis):
            return white
        left = white.copy()
        left.reshape(-1)[:] -= (basis @ white.reshape(-1)) @ basis
        return left

    return taken


def orthonormal(rows: Directions, among: Directions | None = None) -> Directions:
    """Turn directions into orthonormal ones, without those that others have all of.

    Args:
        rows: Shape (k, K).
        among: Orthonormal directions that come first, shape (j, K).
    """
    basis = [] if among is None else list(among)
    for row in rows:
        own = row.copy()
        for other in basis:
            own -= (own @ other) * other
        if (size := float(own @ own)) > _BLIND * float(row @ row):
            basis.append(own / np.sqrt(size))
    return np.array(basis).reshape(len(basis), rows.shape[1])
