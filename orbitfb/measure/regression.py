"""One column of R from the orbits at its steps: ordinary least squares, and what it leaves.

The orbit of every BPM at level u (from −1 to 1) and time t is fitted by

    orbit = c + d t + r u,

so that a linear drift d stays out of the response r. With u² and u³ besides, the fit tells what of
the response is not linear: with S₁ and S₂ the sums of squares that the two fits leave over all K
steps and n BPMs, and s² = S₂ / n (K − 5) the noise, that part is

    √((S₁ − S₂ − 2 n s²) / n K)  over  the rms of r u.

Source: any text on linear regression, e.g. Draper and Smith, Applied Regression Analysis, ch. 2.
"""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector

_CURVED = 2
"""Terms that the curved fit has besides: u² and u³."""
SIGNIFICANT = 4.0
"""Ratio of variances from which a curvature is not noise."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A fitted column, per level 1.

    Args:
        response: r, shape (n,) [m]; NaN at a BPM that was not valid at every step.
        sigma: Its standard deviation, shape (n,) [m].
        noise: What the straight fit leaves over, rms [m].
        linearity: Part of the response that is not linear, rms over rms [1].
    """

    response: Vector
    sigma: Vector
    noise: float
    linearity: float


def fit_column(level: Vector, time: Vector, orbit: Vector) -> Fit:
    """Fit one column.

    Args:
        level: Of every step, shape (K,), from −1 to 1, K ≥ 6.
        time: When, shape (K,) [s].
        orbit: Mean orbit at every step, shape (K, n) [m]; NaN where a BPM was not valid.
    """
    steps, bpms = orbit.shape
    valid = np.isfinite(orbit).all(axis=0)
    nothing = np.full(bpms, np.nan)
    if not valid.any():
        return Fit(nothing, nothing, np.nan, np.nan)
    seen = orbit[:, valid]
    clock = (time - time.mean()) / max(float(np.ptp(time)), 1e-9)
    straight = np.stack([np.ones(steps), clock, level], axis=1)
    curved = np.column_stack([straight, level**2, level**3])
    slope, left = _solve(straight, seen)
    _, curved_left = _solve(curved, seen)
    freedom = steps - straight.shape[1]
    variance = np.sum(left**2, axis=0) / freedom
    share = np.linalg.inv(straight.T @ straight)[2, 2]
    response, sigma = nothing.copy(), nothing.copy()
    response[valid], sigma[valid] = slope[2], np.sqrt(variance * share)
    return Fit(
        response,
        sigma,
        float(np.sqrt(variance.mean())),
        _linearity(left, curved_left, slope[2], level),
    )


def _solve(design: Vector, orbit: Vector) -> tuple[Vector, Vector]:
    solution: Vector = np.linalg.lstsq(design, orbit, rcond=None)[0].astype(np.float64)
    return solution, orbit - design @ solution


def _linearity(left: Vector, curved_left: Vector, slope: Vector, level: Vector) -> float:
    steps, bpms = left.shape
    whole, rest = float(np.sum(left**2)), float(np.sum(curved_left**2))
    noise = rest / (bpms * (steps - 3 - _CURVED))
    gained = max(whole - rest, 0.0)
    if gained <= SIGNIFICANT * _CURVED * bpms * noise:
        return 0.0
    bent = np.sqrt((gained - _CURVED * bpms * noise) / (bpms * steps))
    size = float(np.sqrt(np.mean(slope**2) * np.mean(level**2)))
    return float(bent) / size if size > 0.0 else np.inf
