"""Identify the response matrix from the loop's own transitions: Bayesian, recursive, unbiased.

Innovations of the prefilter (`orbitfb.models.filter`) are a linear regression on the
prefiltered changes φ. Each row of UᵀR is normal with a covariance P, walks at random by Q per
tick, and is updated block by block in information form:

    P ← P + B Q,   P⁺ = (P⁻¹ + Φᵀ Φ / S)⁻¹,   R̂ ← R̂ + Eᵀ Φ P⁺ / S

with S the innovation variance. Rows move only along directions that were excited, the past is
forgotten at the rate Q, and the covariance says what is not known.

While R drifts under setpoints c that stay, the orbit creeps by (dR/dt) c per tick, and the loop
answers with changes that creep as well. Without a term for it, R̂ of those changes would tend to
zero, for together they move nothing. So every row has one more coefficient, the creep of its
mode in metres per tick, whose regressor is 1.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from orbitfb.core.errors import EstimationError
from orbitfb.core.signals import Vector
from orbitfb.models.absorbed import Absorbed, total
from orbitfb.models.comparison import Comparison, Contrast
from orbitfb.models.filter import Carry, PrefilterBank
from orbitfb.models.linear import LinearModel
from orbitfb.models.noise import LADDER, NoiseEstimate
from orbitfb.models.rows import Rows
from orbitfb.models.settings import IdentifySettings

_MANY_KICKS = 0.1
_WIDENINGS = 12


class Identifier:
    """The running estimate of R.

    Args:
        response: R̂ to begin with, shape (n, m) [m/A].
        settings: Prior, drift, noise.

    Raises:
        EstimationError: The response is not a finite matrix, or prior and drift are zero.
    """

    def __init__(self, response: Vector, settings: IdentifySettings) -> None:
        if response.ndim != 2 or not np.isfinite(response).all() or not np.any(response):
            raise EstimationError(
                f"the first response matrix (shape {response.shape}) must be a finite matrix "
                "that is not zero; compute or measure it again"
            )
        rows, columns = response.shape
        relative = response.T @ response / rows
        self._prior = settings.prior_entry**2 * np.eye(columns)
        self._prior += settings.prior_relative**2 * relative
        self._drift = settings.drift_entry**2 * np.eye(columns)
        self._drift += settings.drift_relative**2 * relative
        if not np.any(self._prior):
            raise EstimationError(
                "prior_entry and prior_relative are both 0: nothing can be learnt"
            )
        self._prior += 1e-12 * np.trace(self._prior) / columns * np.eye(columns)
        self._prior = _bordered(self._prior, settings.creep**2)
        self._drift = _bordered(self._drift, settings.creep**2 / settings.creep_memory)
        self._settings = settings
        self._modes = np.linalg.svd(response)[0]
        self._rows = _with_creep(self._modes.T @ response)
        self._covariances = np.repeat(self._prior[None], len(LADDER), axis=0)
        self._bank = PrefilterBank(LADDER)
        self._carry = self._bank.start(columns + 1 + rows)
        self._noise = NoiseEstimate(
            rows, settings.reading_noise, settings.ground, settings.noise_memory, 50.0
        )
        self._last_tick: int | None = None
        self._comparison: Comparison | None = None

    @property
    def last_tick(self) -> int | None:
        """Tick of the last transition that was taken in; None before the first."""
        return self._last_tick

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

    def absorb(self, rows: Rows, other: Vector | None = None) -> Absorbed:
        """Take rows in, block by block.

        Args:
            rows: What `select_rows` let through, later than all rows before.
            other: A response to compare with, shape (n, m) [m/A]; None: R̂ as it stands.
        """
        if not len(rows):
            return Absorbed(0, 0, float("nan"), float("nan"), float("nan"))
        other_rows = self._rows.copy()
        if other is not None:
            other_rows[:, :-1] = self._modes.T @ other
        self._compare_with(None if other is None else other_rows[:, :-1])
        starts = rows.starts.copy()
        starts[0] = self._last_tick is None or rows.tick[0] != self._last_tick + 1
        rows = replace(rows, starts=starts)
        size = self._settings.block
        pieces = [
            self._absorb_block(rows.take(begin, begin + size), other_rows)
            for begin in range(0, len(rows), size)
        ]
        return total(pieces)

    def _compare_with(self, other: Vector | None) -> None:
        """Begin a comparison with another response; one that goes on keeps what it has learnt."""
        if other is None:
            self._comparison = None
        elif self._comparison is None or not np.array_equal(self._comparison.response, other):
            self._comparison = Comparison(other, self._settings, self._comparison)

    def _absorb_block(self, rows: Rows, other: Vector) -> Absorbed:
        first, last = int(rows.tick[0]), int(rows.tick[-1])
        elapsed = last - (first - 1 if self._last_tick is None else self._last_tick)
        self._covariances += elapsed * self._drift
        kicks, interrupted = 0, False
        block = self._filter(rows)
        while (kicked := block.chi2 > self._settings.kick_chi2).any():
            if kicks >= max(3.0, _MANY_KICKS * elapsed) or len(rows) == 1:
                block = self._reopen(rows)
                break
            worst = int(np.argmax(kicked))
            kicks += 1
            interrupted = interrupted or worst + 1 == len(rows)
            rows = rows.without(worst)
            block = self._filter(rows)
        self._carry = Carry(block.carry.columns, 0) if interrupted else block.carry
        self._last_tick = last
        absorbed = self._score(block, rows, other, kicks)
        self._noise.absorb(block.squares, block.counted)
        self._update(block)
        return absorbed

    def _reopen(self, rows: Rows) -> "_Block":
        """Widen the uncertainty until the rows are no surprise: R is not what it was."""
        block = self._filter(rows)
        for _ in range(_WIDENINGS):
            if np.median(block.chi2) < self._settings.kick_chi2:
                break
            self._covariances *= 4.0
            block = self._filter(rows)
        return block

    def _filter(self, rows: Rows) -> "_Block":
        """Filter a block and find its innovations before it has taught anything."""
        changes = np.column_stack([rows.change, np.ones(len(rows))])
        columns = changes.shape[1]
        expected = changes @ (self._modes @ self._rows).T
        difference = np.where(rows.valid, rows.difference, expected) @ self._modes
        both = np.concatenate([changes, difference], axis=1)
        filtered, weights, carry = self._bank.run(both, rows.starts, self._carry)
        filtered *= weights[:, :, None]
        regressors, responses = filtered[:, :, :columns], filtered[:, :, columns:]
        innovations = responses - regressors @ self._rows.T
        variances = self._noise.innovation_variances
        constant, creeps = regressors[:, :, -1], self._covariances[:, -1, :]
        doubts = np.einsum("gtm,gtm->gt", regressors @ self._covariances, regressors)
        # The noise is learnt from rows that R̂ predicts well. The creep is left out of that: its
        # prior is wide, and where nothing creeps it would explain a part of the noise.
        with_creep = 2.0 * (regressors @ creeps[:, :, None])[:, :, 0] * constant
        doubts_of_r = doubts - with_creep + constant**2 * creeps[:, -1:]
        certain = variances[:, None] / (variances[:, None] + np.maximum(doubts_of_r, 0.0))
        levels = self._noise.levels
        own = innovations[levels, :, np.arange(len(levels))]
        total = (variances[:, None] + doubts)[levels]
        chi2 = np.mean(own**2 / total, axis=0)
        known = (certain[levels].mean(axis=0) > 0.5) & (chi2 < self._settings.kick_chi2)
        squares = np.einsum("gtn,gt,t->gn", innovations**2, certain, known)
        return _Block(
            regressors, responses, innovations, own, total, chi2, squares, float(known.sum()), carry
        )

    def _score(self, block: "_Block", rows: Rows, other: Vector, kicks: int) -> Absorbed:
        levels = self._noise.levels
        variances = self._noise.innovation_variances[levels]
        theirs = np.empty_like(block.own)
        for level in np.unique(levels):
            members = levels == level
            theirs[members] = (
                block.responses[level][:, members] - block.regressors[level] @ other[members].T
            ).T
        constant = block.regressors[levels, :, -1]
        theirs = _without_creep(theirs, constant)
        own = _without_creep(block.own, constant)
        chi2_other = theirs**2 / variances[:, None]
        evidence = 0.5 * float(np.sum((theirs**2 - own**2) / block.total))
        moved = self._rows[:, :-1] @ rows.dither.T
        return Absorbed(
            rows=len(rows),
            kicks=kicks,
            chi2=float(block.chi2.mean()),
            chi2_other=float(chi2_other.mean()),
            nats=evidence / max(len(rows), 1),
            dither_pull=float(np.sum(moved * block.own / variances[:, None])),
            dither_information=float(np.sum(moved**2 / variances[:, None])),
            contrasts=self._contrast(block),
        )

    def _contrast(self, block: "_Block") -> tuple[Contrast, ...]:
        if self._comparison is None:
            return ()
        return (self._comparison.absorb(block.regressors[:, :, :-1], block.responses),)

    def _update(self, block: "_Block") -> None:
        levels = self._noise.levels
        variances = self._noise.innovation_variances
        for level, regressor in enumerate(block.regressors):
            members = levels == level
            after, gain = _posterior(self._covariances[level], regressor, variances[level])
            self._rows[members] += block.innovations[level][:, members].T @ gain
            self._covariances[level] = after


def _posterior(before: Vector, regressor: Vector, variance: float) -> tuple[Vector, Vector]:
    """Give P⁺, shape (k, k), and what the innovations of T rows are worth, Φ P⁺ / S, (T, k).

    In covariance form, P⁺ = P − P Φᵀ (S I + Φ P Φᵀ)⁻¹ Φ P, where there are fewer rows than
    coefficients; in information form otherwise.
    """
    count, size = regressor.shape
    if count < size:
        seen = regressor @ before
        factor = np.linalg.cholesky(seen @ regressor.T + variance * np.eye(count))
        root = solve_triangular(factor, seen, lower=True, check_finite=False)
        gain = solve_triangular(factor, root, lower=True, trans=1, check_finite=False)
        return before - root.T @ root, gain
    information = regressor.T @ regressor / variance
    after = np.linalg.solve(np.eye(size) + before @ information, before)
    after = 0.5 * (after + after.T)
    return after, regressor @ after / variance


@dataclass(frozen=True, slots=True)
class _Block:
    """A filtered block: by level (G, T, ·), by mode (n, T), by row (T,)."""

    regressors: Vector
    responses: Vector
    innovations: Vector
    own: Vector
    total: Vector
    chi2: Vector
    squares: Vector
    counted: float
    carry: Carry


def _bordered(covariance: Vector, creep: float) -> Vector:
    """Add the variance of the creep as the last coefficient."""
    size = len(covariance)
    whole = np.zeros((size + 1, size + 1))
    whole[:size, :size] = covariance
    whole[size, size] = creep
    return whole


def _with_creep(rows: Vector) -> Vector:
    """Add a creep of zero to every row."""
    return np.column_stack([rows, np.zeros(len(rows))])


def _without_creep(innovations: Vector, constant: Vector) -> Vector:
    """Take out of each mode's innovations, shape (n, T), what a creep of its own would explain."""
    share = np.sum(innovations * constant, axis=1) / np.sum(constant**2, axis=1)
    return innovations - share[:, None] * constant
