"""Quadrupoles that a response cannot tell apart: classes, and how well their sum is known."""

import numpy as np

from orbitfb.loco.parameters import Fit

ALIKE = 0.95
"""Cosine of what two gradients do to the response from which they are alike [1]."""


def degenerate(fit: Fit, names: tuple[str, ...]) -> list[tuple[tuple[str, ...], float]]:
    """Find for every quadrupole those that do the same to the response.

    Two gradients are alike when their columns of the Jacobian, with all gains, calibrations and
    phases fitted, have a cosine of `ALIKE`: the data know their sum, not the two.

    Args:
        fit: The fit.
        names: Of the quadrupoles.

    Returns:
        Names of the others in its class, and the standard deviation of the sum of ΔK/K.
    """
    index = fit.groups.of["gradient"]
    others = np.setdiff1d(np.arange(fit.groups.size), index)
    prior = fit.posterior.prior[others]
    inner = fit.matrix[np.ix_(others, others)] + np.diag(1.0 / prior)
    cross = fit.matrix[np.ix_(others, index)]
    seen = fit.matrix[np.ix_(index, index)] - cross.T @ np.linalg.solve(inner, cross)
    size = np.sqrt(np.maximum(np.diag(seen), 1e-300))
    alike = seen / np.outer(size, size)
    covariance = fit.posterior.covariance[np.ix_(index, index)]
    found: list[tuple[tuple[str, ...], float]] = []
    for number in range(len(index)):
        its = np.flatnonzero(alike[number] > ALIKE)
        whole = np.union1d(its, [number])
        sigma = float(np.sqrt(covariance[np.ix_(whole, whole)].sum()))
        found.append((tuple(names[int(i)] for i in whole if i != number), sigma))
    return found
