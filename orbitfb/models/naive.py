"""The naive refit, kept as the example of what goes wrong."""

import numpy as np

from orbitfb.core.errors import EstimationError
from orbitfb.core.signals import Vector
from orbitfb.models.rows import Rows

_WORST_PIVOT = 1e-5
"""Ratio of Cholesky pivots below which the normal equations are not trusted; its square is about
the inverse of their condition number, so that at least 5 digits remain."""


def naive_least_squares(rows: Rows) -> Vector:
    """Regress s_{n+1} − s_n on a_n, as the paper's formula for R̂ does.

    R̂ = (Σ Δs aᵀ)(Σ a aᵀ)⁻¹ is *wrong in closed loop*: with a_n = −K y_n the reading noise of
    y_n stands on both sides, so that at the noise floor −R̂K tends to 1 + g/2 where the loop
    gain is g, whatever R is: a bias that more data do not lower.

    Args:
        rows: At least as many as there are correctors.

    Returns:
        R̂, shape (n, m) [m/A].

    Raises:
        EstimationError: There are fewer rows than correctors.
    """
    correctors = rows.change.shape[1]
    if len(rows) < correctors:
        raise EstimationError(
            f"{len(rows)} transitions do not determine the response to {correctors} correctors; "
            "record longer"
        )
    changes, differences = rows.change, rows.difference
    moment = changes.T @ changes
    try:
        diagonal = np.diag(np.linalg.cholesky(moment))
    except np.linalg.LinAlgError:
        diagonal = np.zeros(1)
    if np.min(diagonal) > _WORST_PIVOT * np.max(diagonal):
        transposed = np.linalg.solve(moment, changes.T @ differences)
    else:  # directions that were hardly excited: slower, and without squaring
        transposed = np.linalg.lstsq(changes, differences, rcond=None)[0]
    return np.asarray(transposed.T, dtype=np.float64)
