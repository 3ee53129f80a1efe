"""The identification as it was: the filter's recursion, block by block, kept to compare with.

Innovations of the prefilter (`orbitfb.models.filter`) are a regression on prefiltered changes φ.
The rows of UᵀR walk at random by Q per tick and are updated every hundred rows:

    P ← P + B Q,   P⁺ = (P⁻¹ + Φᵀ Φ / S)⁻¹,   R̂ ← R̂ + Eᵀ Φ P⁺ / S

Rows are taken as they come: the screen for kicks and for BPMs that are not valid is left out.
"""

import numpy as np
from scipy.linalg import solve_triangular

from orbitfb.core.signals import Vector
from orbitfb.models.filter import PrefilterBank
from orbitfb.models.linear import LinearModel
from orbitfb.models.noise import LADDER, NoiseEstimate
from orbitfb.models.rows import Rows
from orbitfb.models.settings import IdentifySettings

_BLOCK = 100


class BlockByBlock:
    """The running estimate of R.

    Args:
        response: R̂ to begin with, shape (n, m) [m/A].
        settings: Prior, drift, noise.
    """

    def __init__(self, response: Vector, settings: IdentifySettings) -> None:
        modes, columns = response.shape
        relative = response.T @ response / modes
        prior = settings.prior_entry**2 * np.eye(columns) + settings.prior_relative**2 * relative
        drift = settings.drift_entry**2 * np.eye(columns) + settings.drift_relative**2 * relative
        self._drift = np.pad(drift, (0, 1))
        self._drift[-1, -1] = settings.creep**2 / settings.creep_memory
        prior = np.pad(prior, (0, 1))
        prior[-1, -1] = settings.creep**2
        self._modes = np.linalg.svd(response)[0]
        self._rows = np.column_stack([self._modes.T @ response, np.zeros(modes)])
        self._covariances = np.repeat(prior[None], len(LADDER), axis=0)
        self._bank = PrefilterBank(LADDER)
        self._carry = self._bank.start(columns + 1 + modes)
        self._noise = NoiseEstimate(
            modes, settings.reading_noise, settings.ground, settings.noise_memory, 50.0
        )

    @property
    def model(self) -> LinearModel:
        """The estimate as it stands, copied."""
        return LinearModel(
            response=self._modes @ self._rows[:, :-1],
            modes=self._modes,
            levels=self._noise.levels.copy(),
            covariances=self._covariances[:, :-1, :-1].copy(),
            reading_variance=self._noise.reading_variance,
            ground_variances=self._noise.ground_variances,
            creep=self._rows[:, -1].copy(),
        )

    def absorb(self, rows: Rows) -> None:
        """Take rows in, block by block."""
        for begin in range(0, len(rows), _BLOCK):
            self._absorb_block(rows.take(begin, begin + _BLOCK))

    def _absorb_block(self, rows: Rows) -> None:
        self._covariances += len(rows) * self._drift
        changes = np.column_stack([rows.change, np.ones(len(rows))])
        size = changes.shape[1]
        both = np.concatenate([changes, rows.difference @ self._modes], axis=1)
        filtered, weights, self._carry = self._bank.run(both, rows.starts, self._carry)
        filtered *= weights[:, :, None]
        regressors, responses = filtered[:, :, :size], filtered[:, :, size:]
        innovations = responses - regressors @ self._rows.T
        doubts = np.einsum("gtm,gtm->gt", regressors @ self._covariances, regressors)
        variances = self._noise.innovation_variances
        certain = variances[:, None] / (variances[:, None] + doubts)
        self._noise.absorb(np.einsum("gtn,gt->gn", innovations**2, certain), float(len(rows)))
        variances = self._noise.innovation_variances
        for level, regressor in enumerate(regressors):
            members = self._noise.levels == level
            seen = regressor @ self._covariances[level]
            covariance = seen @ regressor.T + variances[level] * np.eye(len(rows))
            factor = np.linalg.cholesky(covariance)
            root = solve_triangular(factor, seen, lower=True, check_finite=False)
            gain = solve_triangular(factor, root, lower=True, trans=1, check_finite=False)
            self._rows[members] += innovations[level][:, members].T @ gain
            self._covariances[level] -= root.T @ root
