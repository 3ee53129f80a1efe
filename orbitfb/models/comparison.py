"""Ask whether a fixed response still explains the rows: the score of a change, block by block.

A loop at its noise floor says little about R, and what a drift does to the mean squared
innovation is less than what a misjudged noise does. But a wrong response shows in *correlation*:
the innovations ν under the response then follow the prefiltered changes φ. With a change of R
whose elements are normal of rms p, its expectation from the rows so far is, for the row of a mode,

    δ̂ = (Σ ν φᵀ / S) (Σ φ φᵀ / S + I / p²)⁻¹,

and d = δ̂ φ predicts the *next* innovations. If the response is right, innovations are white and
pull = Σ ν d / S has zero mean and the variance information = Σ d² / S given the past, whatever d:
pull − information / 2 is a log-likelihood ratio, of which a detector can be made
(`orbitfb.models.changes`).

What the noise can imitate is left out: the slope of a mode's innovations on the mode's own
predicted motion (a Kalman gain that is misjudged makes one) is removed from ν and from d. The
noise is estimated from the innovations under the response that is asked about, not from those
under R̂, which follows the rows and makes them look calmer.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from orbitfb.core.signals import Vector
from orbitfb.models.noise import LADDER, NoiseEstimate
from orbitfb.models.settings import IdentifySettings

_SOLVE_EVERY = 100
_SLOPE_BELIEF = 25.0
_LARGE_MOTION = 10.0
_USUAL_MEMORY = 300.0
_SETTLE = 200
"""Rows that only teach the noise: with a gain that is not known yet nothing can be told."""


@dataclass(frozen=True, slots=True)
class Contrast:
    """What rows say about a response that is held fixed; sums over rows and modes.

    Args:
        rows: Rows that counted.
        pull: Innovations against the motion that a change of R, learnt from earlier rows,
            predicts, in units of the noise [nats].
        information: Variance of `pull` when R is as it was; mean of it, when R has changed to
            what is predicted [nats].
        sensitivity: What `information` would be if a change of the expected size were known:
            what the rows are worth [nats].
        chi2: Mean squared innovation in units of the noise; 1 when the noise is right.
    """

    rows: int = 0
    pull: float = 0.0
    information: float = 0.0
    sensitivity: float = 0.0
    chi2: float = float("nan")


class Comparison:
    """Running comparison of the rows with one response.

    Args:
        response: Rows of UᵀR, U the modes, shape (n, m) [m/A].
        settings: First belief about the noise, expected size of a change, memory.
        former: A comparison with another response, on the rows before: its noise is taken over.
    """

    def __init__(
        self, response: Vector, settings: IdentifySettings, former: "Comparison | None" = None
    ) -> None:
        self.response = response
        count, columns = response.shape
        self._settings = settings
        if former is None:
            self._noise = NoiseEstimate(
                count, settings.reading_noise, settings.ground, settings.noise_memory, 50.0
            )
            self._unsettled = _SETTLE
        else:
            self._noise, self._unsettled = former._noise, former._unsettled
        self._scores = np.zeros((count, columns))
        self._moments = np.zeros((len(LADDER), columns, columns))
        self._change = np.zeros((count, columns))
        self._slope_pull = np.zeros(count)
        self._slope_information = np.zeros(count)
        self._unsolved = 0
        self._usual: float | None = None

    def absorb(self, regressors: Vector, responses: Vector) -> Contrast:
        """Take in prefiltered rows.

        Args:
            regressors: φ for every gain of the ladder, shape (G, T, m) [A].
            responses: Prefiltered differences in modes, shape (G, T, n) [m].

        Returns:
            What they say, judged by what was known before them.
        """
        predicted = regressors @ self.response.T
        innovations = responses - predicted
        levels = self._noise.levels.copy()
        variances = self._noise.innovation_variances
        modes = np.arange(len(levels))
        raw, motion = innovations[levels, :, modes], predicted[levels, :, modes]
        variance = variances[levels][:, None]
        fit = np.mean(raw**2 / variance, axis=0) < self._settings.kick_chi2
        if not fit.any():
            return Contrast()
        raw, motion = raw[:, fit], motion[:, fit]
        regressors, innovations = regressors[:, fit], innovations[:, fit]
        self._noise.absorb(np.sum(innovations**2, axis=1), float(fit.sum()))
        weights = np.sqrt(self._weigh(np.mean(motion**2 / variance, axis=0)))
        raw, motion, regressors = raw * weights, motion * weights, regressors * weights[:, None]
        slope = self._slope_pull / (self._slope_information + _SLOPE_BELIEF)
        own = raw - slope[:, None] * motion
        shift = np.empty_like(own)
        for level in np.unique(levels):
            members = levels == level
            shift[members] = self._change[members] @ regressors[level].T
        squares = np.sum(regressors**2, axis=2)[levels]
        contrast = Contrast(
            rows=int(fit.sum()),
            pull=float(np.sum(own * shift / variance)),
            information=float(np.sum(shift**2 / variance)),
            sensitivity=self._settings.change_entry**2 * float(np.sum(squares / variance)),
            chi2=float(np.mean((own / weights) ** 2 / variance)),
        )
        if self._unsettled > 0:
            self._unsettled -= contrast.rows
            return Contrast()
        self._learn(regressors, raw, own, motion, levels, variances)
        return contrast

    def _weigh(self, motion: Vector) -> Vector:
        """Weights of rows, shape (T,), from their mean squared motion in units of the noise.

        The answer to a kick moves the orbit so far that a few rows would outweigh all others;
        the row counts as if its noise were larger.
        """
        moved = np.log(np.maximum(motion, np.finfo(float).tiny))
        middle = float(np.mean(moved))
        if self._usual is None:
            self._usual = float(np.median(moved))
        weights = np.exp(np.minimum(0.0, np.log(_LARGE_MOTION) + self._usual - moved))
        self._usual += (middle - self._usual) * -np.expm1(-len(moved) / _USUAL_MEMORY)
        return weights

    def _learn(
        self,
        regressors: Vector,
        raw: Vector,
        own: Vector,
        motion: Vector,
        levels: np.ndarray,
        variances: Vector,
    ) -> None:
        rows = raw.shape[1]
        fade = np.exp(-rows / self._settings.change_memory)
        variance = variances[levels]
        for total in (self._scores, self._moments, self._slope_pull, self._slope_information):
            total *= fade
        self._slope_pull += np.sum(raw * motion, axis=1) / variance
        self._slope_information += np.sum(motion**2, axis=1) / variance
        self._moments += np.swapaxes(regressors, 1, 2) @ regressors / variances[:, None, None]
        for level in np.unique(levels):
            members = levels == level
            self._scores[members] += own[members] @ regressors[level] / variances[level]
        self._unsolved += rows
        if self._unsolved >= _SOLVE_EVERY:
            self._unsolved = 0
            self._solve(levels)

    def _solve(self, levels: np.ndarray) -> None:
        """Expect a change of R, orthogonal to a larger or smaller response of the mode itself."""
        prior = np.eye(self.response.shape[1]) / self._settings.change_entry**2
        for level in np.unique(levels):
            members = levels == level
            moment, along = self._moments[level], self.response[members]
            seen = along @ moment
            norm = np.maximum(np.sum(seen * along, axis=1, keepdims=True), np.finfo(float).tiny)
            scores = self._scores[members]
            scores = scores - seen * (np.sum(scores * along, axis=1, keepdims=True) / norm)
            factor = scipy.linalg.cho_factor(moment + prior)
            change = scipy.linalg.cho_solve(factor, scores.T).T
            change -= along * (np.sum(change * seen, axis=1, keepdims=True) / norm)
            self._change[members] = change
