"""What correctors reach: what of an orbit error stays under any law, and what correcting takes."""

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.core.transitions import Transitions
from orbitfb.models.linear import LinearModel
from orbitfb.policies.inverse import regularised_inverse

ROWS = 100
"""Last rows of the closed loop over which the orbit error is averaged: of that many the noise of a
reading is a tenth of what it is [1]."""

_SMALLEST = 1e-3
"""Share of the largest singular value below which a pattern counts as not reached [1]: correctors
would be at their limits before it is gone."""


def mean_error(transitions: Transitions) -> Vector | None:
    """Average the orbit error of the last rows of the closed loop, shape (n,) [m].

    Args:
        transitions: Whose last rows count.

    Returns:
        NaN at BPMs that were not valid throughout; None: no row was closed.
    """
    rows = np.flatnonzero(transitions.closed)[-ROWS:]
    if not len(rows):
        return None
    error = transitions.orbit[rows] - transitions.reference[rows]
    valid = transitions.valid[rows].all(axis=0)
    return np.where(valid, np.where(valid, error, 0.0).mean(axis=0), np.nan)


def unreachable_rms(error: Vector, response: Vector, moving: Mask) -> float:
    """Tell what of an orbit error the correctors cannot reach, rms over the valid BPMs [m].

    Args:
        error: Shape (n,) [m]; NaN at BPMs that do not count.
        response: Shape (n, m) [m/A].
        moving: Correctors that may move, shape (m,).
    """
    valid = np.isfinite(error)
    if not valid.any() or not moving.any():
        return float(np.sqrt(np.mean(error[valid] ** 2))) if valid.any() else 0.0
    known = response[np.ix_(valid, moving)]
    squares, patterns = np.linalg.eigh(known @ known.T)  # half the time of the singular values
    beyond = patterns[:, squares <= _SMALLEST**2 * squares[-1]]
    return float(np.linalg.norm(error[valid] @ beyond) / np.sqrt(np.count_nonzero(valid)))


def needed_change(model: LinearModel, moving: Mask, amplitude: float) -> float:
    """Give the change that corrects a white orbit error whole, by R̂ as far as it is known.

    It is that of the cautious inverse (`policies.inverse`), without regularisation: a gain that
    asks for more overshoots, or trusts what the data do not show.

    Args:
        model: The posterior of R.
        moving: Correctors that may move, shape (m,).
        amplitude: Of the orbit error, rms [m].

    Returns:
        Rms over all m correctors [A].
    """
    if not moving.any():
        return 0.0
    doubt = model.row_covariance[np.ix_(moving, moving)]
    inverse = regularised_inverse(model.response[:, moving], 0.0, doubt)
    return amplitude * float(np.linalg.norm(inverse) / np.sqrt(len(moving)))
