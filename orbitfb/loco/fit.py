"""The fit in the planes: gains, calibrations and gradients by damped Gauss-Newton steps.

The model is that of `loco.forward`; the optics with the errors are rebuilt at every step. All
deviations have normal priors whose spreads are estimated with them: gains and calibrations
robustly, gradients by evidence. A device that stands out by more than `STANDS_OUT` is let free, so
that it does not drag others along. Gauge: readings have gain 1 on average; the common factor is in
the scale of a plane.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from orbitfb.core.errors import RingError
from orbitfb.core.signals import Mask, Vector
from orbitfb.loco.forward import PlaneModel
from orbitfb.loco.measured import Measured
from orbitfb.loco.noise import separable, spreads
from orbitfb.loco.optics import PlaneOptics, RingOptics
from orbitfb.loco.parameters import (
    BELIEVED,
    FIRST_SPREAD,
    LEAST_SPREAD,
    MOST_GRADIENT,
    MOST_NOISE,
    OUTLIER,
    STANDS_OUT,
    Fit,
    Noise,
    centred,
)
from orbitfb.loco.posterior import (
    WIDE,
    Posterior,
    evidence_spread,
    most_likely,
    posterior,
    robust_spread,
)
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Plane

_MOST_STEPS = 30
_MOST_HALVINGS = 6
_WEIGHING = 4
"""Steps near the end in which noise and healthy spreads are estimated; then they are settled."""
_NEAR = 1.0
"""Largest step, in standard deviations, at which rows may have noise of their own: earlier a row
that the optics do not reach yet would be taken for a noisy one, and never be reached."""
_CONVERGED = 0.05
"""Largest step, in standard deviations of its parameter, at which the fit has arrived [1]."""


class PlaneFit:
    """Fits the own blocks of a measured response.

    Args:
        optics: The ring at the devices of the measurement.
        measured: The measurement.
        progress: Called with the share of the work that is done.
    """

    def __init__(
        self,
        optics: RingOptics,
        measured: Measured,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self.optics, self.measured = optics, measured
        self.model = PlaneModel(optics, measured)
        self._progress = progress or (lambda share: None)
        self._known = {plane: separable(measured.sigma[plane, plane]) for plane in measured.planes}

    def start(self) -> Vector:
        """Begin with the gains of rows and columns by the optics of the table."""
        theta = np.zeros(self.model.groups.size)
        nominal = self.optics.at(np.zeros(len(self.optics.quadrupoles)))
        for plane in self.measured.planes:
            data = self.measured.response[plane, plane]
            rows, columns = row_and_column_gains(data, nominal[plane].own)
            scale = float(np.median(columns))
            theta[self.model.groups.of[f"gain:{plane}"]] = rows - 1.0
            theta[self.model.groups.of[f"scale:{plane}"]] = scale - 1.0
            theta[self.model.groups.of[f"calibration:{plane}"]] = columns - scale
        return theta

    def run(self) -> Fit:
        """Fit.

        Raises:
            RingError: The optics of the table cannot be brought near the measurement.
        """
        theta, spread = self.start(), self._first_spread()
        free = np.zeros(self.model.groups.size, dtype=np.bool_)
        optics = self.optics.at(theta[self.model.groups.of["gradient"]])
        steps, near, converged = 0, 0, False
        noise: dict[Plane, Noise] = {}
        for steps in range(1, _MOST_STEPS + 1):
            settled = near > _WEIGHING
            if not settled:
                noise = self._noise(theta, optics, near == 0)
            matrix, pull = self.model.normal(theta, optics, noise)
            its = self._posterior(theta, matrix, pull, self._prior(spread, free), near > 0)
            if not settled:
                spread = self._spreads(its, spread, free, near > 0)
                free = self._standing(its, spread)
            theta, optics, size = self._step(theta, optics, noise, its)
            self._progress(steps / _MOST_STEPS)
            if settled and size < _CONVERGED:
                converged = True
                break
            near += near > 0 or size < _NEAR or steps >= _MOST_STEPS // 2
        noise = self._noise(theta, optics, False)
        matrix, pull = self.model.normal(theta, optics, noise)
        its = self._posterior(theta, matrix, pull, self._prior(spread, free), True)
        return Fit(
            self.model.groups, theta, replace(its, mean=theta), matrix, free, spread, noise, steps,
            converged, {p: self.model.response(theta, optics, p) for p in self.measured.planes},
            optics, self.model.residuals(theta, optics),
        )  # fmt: skip

    def halves(self, fit: Fit, by_column: bool) -> tuple[Vector, Vector]:
        """Fit to every other column (or row) and to the rest, one step from the whole fit."""
        found: list[Vector] = []
        for first in (0, 1):
            noise: dict[Plane, Noise] = {}
            for plane, its in fit.noise.items():
                kept = its.kept.copy()
                if by_column:
                    kept[:, first::2] = False
                else:
                    kept[first::2] = False
                noise[plane] = replace(its, kept=kept)
            matrix, pull = self.model.normal(fit.theta, fit.optics, noise)
            pull = pull + matrix @ fit.theta
            found.append(most_likely(matrix, pull, fit.posterior.prior))
        return found[0], found[1]

    def _first_spread(self) -> dict[str, float]:
        return {name: FIRST_SPREAD.get(name.split(":")[0], 1.0) for name in self.model.groups.of}

    def _prior(self, spread: dict[str, float], free: Mask) -> Vector:
        prior = np.empty(self.model.groups.size)
        for name, index in self.model.groups.of.items():
            prior[index] = WIDE if name.startswith(("scale", "rf")) else spread[name] ** 2
        prior[free] = WIDE
        return prior

    def _posterior(
        self, theta: Vector, matrix: Matrix, pull: Vector, prior: Vector, whole: bool
    ) -> Posterior:
        """Solve for all parameters, or far from the end without local phases, which wait there."""
        active = np.ones(self.model.groups.size, dtype=np.bool_)
        if not whole:
            for name, index in self.model.groups.of.items():
                active[index] = not name.startswith(("row-phase", "column-phase"))
        some = np.flatnonzero(active)
        its = posterior(matrix[np.ix_(some, some)], (pull + matrix @ theta)[some], prior[some])
        mean, covariance = theta.copy(), np.diag(prior)
        mean[some] = its.mean
        covariance[np.ix_(some, some)] = its.covariance
        return Posterior(mean, covariance, prior)

    def _spreads(
        self, its: Posterior, spread: dict[str, float], free: Mask, whole: bool
    ) -> dict[str, float]:
        """Estimate the healthy spread of every group."""
        found = dict(spread)
        for name, index in self.model.groups.of.items():
            kind = name.split(":")[0]
            if kind in ("gain", "calibration") or (whole and kind.endswith("phase")):
                found[name] = robust_spread(its, index, LEAST_SPREAD[kind])
            elif kind in ("gradient", "energy"):
                its_own = evidence_spread(its, index[~free[index]], LEAST_SPREAD[kind])
                found[name] = min(its_own, MOST_GRADIENT) if kind == "gradient" else its_own
        return found

    def _standing(self, its: Posterior, spread: dict[str, float]) -> Mask:
        free = np.zeros(self.model.groups.size, dtype=np.bool_)
        for name, index in self.model.groups.of.items():
            if name.startswith(("scale", "rf")):
                continue
            z = its.standing(index, spread[name], centred(name))
            if centred(name):
                free[index] = z > STANDS_OUT
            else:  # one at a time: neighbours share what one of them does
                best = int(np.argmax(z)) if len(z) else 0
                free[index] = (its.prior[index] >= WIDE) & (z > STANDS_OUT)
                if len(z) and z[best] > STANDS_OUT:
                    free[index[best]] = True
        return free

    def _step(
        self,
        theta: Vector,
        optics: dict[Plane, PlaneOptics],
        noise: dict[Plane, Noise],
        its: Posterior,
    ) -> tuple[Vector, dict[Plane, PlaneOptics], float]:
        """Step towards the posterior mean, halved until the objective falls."""
        before = self._objective(theta, optics, noise, its.prior)
        change = its.mean - theta
        for halving in range(_MOST_HALVINGS):
            share = 0.5**halving
            trial = theta + share * change
            try:
                new = self.optics.at(trial[self.model.groups.of["gradient"]])
            except RingError:
                continue
            if self._objective(trial, new, noise, its.prior) <= before * (1.0 + 1e-9):
                return trial, new, float(np.max(np.abs(share * change) / its.sigma))
        return theta, optics, 0.0

    def _objective(
        self,
        theta: Vector,
        optics: dict[Plane, PlaneOptics],
        noise: dict[Plane, Noise],
        prior: Vector,
    ) -> float:
        total = float(np.sum(theta**2 / prior))
        for plane, residual in self.model.residuals(theta, optics).items():
            its = noise[plane]
            total += float(np.sum(np.where(its.kept, residual / its.sigma, 0.0) ** 2))
        if "rf" in self.model.groups.of:
            total += float(np.sum(self.model.rf_residual(theta, optics)[0] ** 2))
        return 0.5 * total

    def _noise(
        self, theta: Vector, optics: dict[Plane, PlaneOptics], even: bool
    ) -> dict[Plane, Noise]:
        """Estimate the noise; `even`: the same of all rows and columns, as far from the end."""
        found: dict[Plane, Noise] = {}
        for plane, residual in self.model.residuals(theta, optics).items():
            there = self.model.there[plane]
            n, m = residual.shape
            freedom = max(1.0 - (n + m + len(self.optics.quadrupoles) / 2) / (n * m), 0.25)
            s, t = spreads(residual, there)
            s = s / np.sqrt(freedom)
            s, t = (
                np.minimum(s, MOST_NOISE * np.nanmedian(s)),
                np.clip(t, 1 / MOST_NOISE, MOST_NOISE),
            )
            if even:
                typical = float(np.nanmedian(s))
                s, t = np.where(np.isfinite(s), typical, s), np.where(np.isfinite(t), 1.0, t)
            known, columns = self._known[plane]
            if np.isfinite(known).any():
                left = float(np.nanmedian(s / known))
                known = known * (left if left < BELIEVED else 1.0)
                t = np.where(np.isfinite(columns), np.maximum(t, columns), t)
                s = np.where(np.isfinite(known), np.maximum(s, known), s)
            sigma = np.outer(s, t)
            outliers = there & (np.abs(residual) > OUTLIER * sigma)
            found[plane] = Noise(
                np.nan_to_num(s, nan=1.0), np.nan_to_num(t, nan=1.0), there & ~outliers, outliers
            )
        return found


def row_and_column_gains(data: Matrix, nominal: Matrix) -> tuple[Vector, Vector]:
    """Fit M_ij = a_i b_j G_ij by the optics as they are; the median a is 1.

    Args:
        data: Measured, shape (n, m); NaN where not.
        nominal: By the optics, the same shape.

    Returns:
        a, shape (n,), and b, shape (m,); 0 where nothing was measured.
    """
    there = np.isfinite(data)
    known, model = np.where(there, data, 0.0), np.where(there, nominal, 0.0)
    rows, columns = np.ones(len(data)), np.ones(data.shape[1])
    for _ in range(20):
        seen = model * rows[:, None]
        columns = np.sum(known * seen, axis=0) / np.maximum(np.sum(seen**2, axis=0), 1e-300)
        seen = model * columns
        rows = np.sum(known * seen, axis=1) / np.maximum(np.sum(seen**2, axis=1), 1e-300)
        middle = float(np.median(rows[there.any(axis=1)])) or 1.0
        rows = rows / middle
    seen = model * rows[:, None]
    columns = np.sum(known * seen, axis=0) / np.maximum(np.sum(seen**2, axis=0), 1e-300)
    return rows, columns
