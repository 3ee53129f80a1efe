"""Innovations of any model of the ring, on windows of a record: what a net is fitted to.

A model f predicts s_{n+1} − s_n = f(s_n, a_n). Its one-step errors d_n hold the reading noise of
s_n, which a feedback has also written into a_n; a fit that makes them small learns the loop's own
law. Filtered mode by mode, e_{n+1} = (1 − L) e_n + d_n (`orbitfb.models.filter`), they are
innovations, which owe nothing to s_n and a_n: making *them* small is maximum likelihood.

Windows of W rows are filtered as stretches of their own, which begin with an orbit that is not
known; a window of one row is the naive one-step error.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.errors import EstimationError
from orbitfb.core.signals import Vector
from orbitfb.models.filter import PrefilterBank
from orbitfb.models.noise import LADDER, NoiseEstimate
from orbitfb.models.rows import Rows


@dataclass(frozen=True, slots=True)
class Noise:
    """The noise of the modes.

    Args:
        levels: Level of the ladder of every mode, shape (n,).
        variances: Variance of the innovations of every mode, shape (n,) [m²].
    """

    levels: NDArray[np.intp]
    variances: Vector

    def filters(self, window: int) -> Vector:
        """Filter of every mode on a window, with the weights of its beginning, shape (n, W, W).

        Divided by the standard deviation of the innovations [1/m].
        """
        bank = PrefilterBank(LADDER)
        starts = np.arange(window) == 0
        kernels, weights, _ = bank.run(np.eye(window), starts, bank.start(window))
        kernels = kernels * weights[:, :, None]
        return kernels[self.levels] / np.sqrt(self.variances)[:, None, None]


def estimate_noise(
    errors: Vector, starts: NDArray[np.bool_], modes: Vector, reading_noise: float, ground: float
) -> Noise:
    """Estimate the noise of the modes from the one-step errors of a response that is about right.

    Args:
        errors: s_{n+1} − s_n − R̂ a_n, shape (T, n) [m].
        starts: Whether a row begins a stretch, shape (T,).
        modes: U, shape (n, n).
        reading_noise: What to believe at first, rms [m].
        ground: What to believe at first, rms per tick [m].
    """
    bank = PrefilterBank(LADDER)
    count = errors.shape[1]
    starts = starts.copy()
    starts[0] = True
    filtered, weights, _ = bank.run(errors @ modes, starts, bank.start(count))
    squares = np.sum((filtered * weights[:, :, None]) ** 2, axis=1)
    estimate = NoiseEstimate(count, reading_noise, ground, 1e12, 1.0)
    estimate.absorb(squares, float(len(errors)))
    levels = estimate.levels.copy()
    return Noise(levels, estimate.innovation_variances[levels])


def windows(rows: Rows, length: int) -> NDArray[np.intp]:
    """Cut a record into windows that no break runs through.

    Args:
        rows: The record.
        length: Rows of a window.

    Returns:
        Index of every row of every window, shape (windows, length).

    Raises:
        EstimationError: No stretch is as long.
    """
    starts = rows.starts.copy()
    if len(starts):
        starts[0] = True
    bounds = [*np.flatnonzero(starts).tolist(), len(rows)]
    begins = [
        begin for first, end in pairwise(bounds) for begin in range(first, end - length + 1, length)
    ]
    if not begins:
        longest = max(np.diff(bounds), default=0)
        raise EstimationError(
            f"the longest unbroken stretch has {longest} rows, windows have {length}; record "
            "longer without a break, or make the windows shorter"
        )
    return np.array(begins)[:, None] + np.arange(length)


def innovations(errors: Vector, index: NDArray[np.intp], noise: Noise, modes: Vector) -> Vector:
    """Filter one-step errors on windows.

    Args:
        errors: Shape (T, n) [m].
        index: Of `windows`, shape (B, W).
        noise: Of the modes.
        modes: U, shape (n, n).

    Returns:
        Innovations in units of their standard deviation, shape (B, W, n).
    """
    filters = noise.filters(index.shape[1])
    return np.einsum("nij,bjn->bin", filters, (errors @ modes)[index], optimize=True)
