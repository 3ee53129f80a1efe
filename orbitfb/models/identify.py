"""Identify the response matrix from the loop's own transitions: Bayesian, unbiased, all at once.

The difference of two readings is R a + creep + ground + the reading noise of both. In the sine
transform of an unbroken stretch that noise is independent from frequency to frequency, so that R̂ is
a weighted regression there (`orbitfb.estimation.statistics`): 511 rows make a chunk, a chunk is a
sum, and R̂ with its covariance follows from the sums by one factorisation for every level of the
noise. The weights of the regression are those of the likelihood, under which the noise that a
feedback writes into its own changes does no harm.

While R drifts under setpoints c that stay, the orbit creeps by (dR/dt) c per tick, and the loop
answers with changes that creep as well. Without a term for it, R̂ of those changes would tend to
zero, for together they move nothing. So every row of UᵀR has one more coefficient, the creep of its
mode in metres per tick, whose regressor is 1.

The RF frequency, where the loop steps it, is one more column (`orbitfb.models.column`).

How long rows count, the rows themselves say (`orbitfb.models.belief`).
"""

from dataclasses import replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.estimation.columns import KnownRf
from orbitfb.estimation.statistics import LONGEST, StepPosterior
from orbitfb.models.absorbed import Absorbed, total
from orbitfb.models.belief import Likelihoods, make_beliefs
from orbitfb.models.column import Belief
from orbitfb.models.contrasts import Contrasts
from orbitfb.models.filter import ground_ratio
from orbitfb.models.linear import LinearModel
from orbitfb.models.noise import LADDER, NoiseEstimate
from orbitfb.models.prediction import Sums, no_sums, sums_of
from orbitfb.models.regressors import Regressors
from orbitfb.models.rows import Rows
from orbitfb.models.settings import IdentifySettings
from orbitfb.models.tail import Tail

_USUAL_KICKS = 0.1
"""Kicks per tick that are the orbit's [1]."""
_MANY_KICKS = 3.0
"""Kicks beyond those that say that R is not what it was."""
_WIDENINGS = 12
_QUICK = 100
"""Rows of a chunk while R drifts quickly: what it moves by in them is far below the doubt that the
drift makes in the memory of the filter, some thousand rows."""
_NO_SURPRISE = 2.0
"""Mean squared normalised difference of rows that a prior explains, with room for their scatter."""


class Identifier:
    """The running estimate of R.

    Args:
        response: R̂ to begin with, shape (n, m) [m/A].
        settings: Prior, drift, noise.
        rf: What is told of the RF; None: it does not step.

    Raises:
        EstimationError: A matrix is not finite or does not fit, or prior and drift are zero.
    """

    def __init__(
        self, response: Vector, settings: IdentifySettings, rf: KnownRf | None = None
    ) -> None:
        self._settings = settings
        self._regressors = regressors = Regressors(response, rf)
        self._modes, self._first = regressors.modes, regressors.first
        modes = len(response)
        self._beliefs = make_beliefs(regressors, regressors.whole(response), settings)
        self._likely = Likelihoods(len(self._beliefs), settings.memory)
        self._noise = NoiseEstimate(
            modes, settings.reading_noise, settings.ground, settings.noise_memory, 50.0
        )
        self._contrasts = Contrasts(settings)
        self._squares, self._counted = np.zeros((len(LADDER), modes)), 0.0
        self._chosen = 0
        self._theirs: Vector | None = None
        self._last_tick: int | None = None
        self._kicks, self._interrupted, self._seen = 0.0, False, 0
        self._begin_tail()

    @property
    def last_tick(self) -> int | None:
        """Tick of the last transition that was taken in; None before the first."""
        return self._last_tick

    @property
    def drift(self) -> int:
        """Which drift R̂ allows for: 0 a slow one, 1 and 2 ever quicker ones."""
        return self._chosen

    @property
    def model(self) -> LinearModel:
        """The estimate as it stands, copied."""
        posterior = self._latest or self._solve_latest()
        belief, levels = self._beliefs[self._chosen], self._noise.levels.copy()
        rows = self._first + posterior.rows
        prior, found, moved = belief.unseen, posterior.covariances, belief.moved
        its = Belief(self._first, prior, rows, found, moved, levels)
        rows, column = self._regressors.share(its, self._settings.rf_error)
        m = self._regressors.correctors
        return LinearModel(
            response=self._modes @ rows[:, :m],
            modes=self._modes,
            levels=levels,
            covariances=posterior.covariances[:, :m, :m].copy(),
            reading_variance=self._noise.reading_variance,
            ground_variances=self._noise.ground_variances,
            creep=rows[:, -1].copy(),
            rf=column,
        )

    def absorb(
        self, rows: Rows, other: Vector | None = None, column: Vector | None = None
    ) -> Absorbed:
        """Take rows in.

        Args:
            rows: What `select_rows` let through, later than all rows before.
            other: A response to compare with, shape (n, m) [m/A]; None: R̂ as it stands.
            column: Its RF column, shape (n,) [m/Hz]; None: the one told.
        """
        if not len(rows):
            return Absorbed(0, 0, float("nan"), float("nan"), float("nan"))
        theirs = self._believed
        if other is not None:
            theirs = self._regressors.in_modes(other, column)
        if self._theirs is None or not np.array_equal(theirs, self._theirs):
            self._theirs, self._sums = theirs, None
        self._contrasts.compare_with(None if other is None else theirs[:, :-1])
        starts = rows.starts.copy()
        starts[0] = self._last_tick is None or rows.tick[0] != self._last_tick + 1
        rows = replace(rows, starts=starts)
        pieces: list[Absorbed] = []
        begin = 0
        while begin < len(rows):
            # R̂ is made anew before it lags behind what the rows have told.
            few, many = self._settings.block, self._seen // 2
            longest = few if self._likely.best else max(few, many)
            room = max(self._longest_tail() - len(self._tail), 1)
            end = begin + min(max(longest - self._unsolved, 1), room)
            pieces.append(self._absorb_piece(rows.take(begin, end), theirs))
            begin = end
            if len(self._tail) >= self._longest_tail():
                self._close_tail()
            elif self._unsolved >= longest:
                self._solve()
        return total(pieces)

    def _absorb_piece(self, rows: Rows, theirs: Vector) -> Absorbed:
        first, last = int(rows.tick[0]), int(rows.tick[-1])
        elapsed = last - (first - 1 if self._last_tick is None else self._last_tick)
        for belief in self._beliefs:
            belief.pass_ticks(elapsed)
        self._last_tick = last
        rows, kicks = self._without_kicks(rows, elapsed)
        if not len(rows):
            return Absorbed(0, kicks, 0.0, 0.0, 0.0)
        changes = self._regressors.of(rows)
        differences = self._differences(rows, changes)
        pull, information = self._ask_dither(rows, changes, differences)
        before = self._sums if self._sums is not None else self._sum_up(theirs)
        self._tail.push(changes, differences, rows.starts)
        self._sums = self._sum_up(theirs)
        self._latest = None
        self._unsolved += len(rows)
        self._seen += len(rows)
        said = self._sums - before
        self._likely.follow(said.densities(len(rows)), len(rows))
        self._squares += np.maximum(said.squares, 0.0)
        self._counted += max(said.counted, 0.0)
        return Absorbed(
            rows=len(rows),
            kicks=kicks,
            chi2=said.chi2 / len(rows),
            chi2_other=said.chi2_other / len(rows),
            nats=said.nats(len(rows)) / len(rows),
            dither_pull=pull,
            dither_information=information,
            contrasts=self._contrasts.absorb(changes[:, :-1], differences, rows.starts),
        )

    def _differences(self, rows: Rows, changes: Vector) -> Vector:
        """Differences in modes, shape (T, n) [m]; what is not valid does what R̂ expects."""
        expected = changes @ (self._modes @ self._believed).T
        return np.where(rows.valid, rows.difference, expected) @ self._modes

    @property
    def _believed(self) -> Vector:
        """Rows of UᵀR̂ and the creep as last solved, shape (n, m + 1)."""
        return self._first + self._beliefs[self._chosen].posterior.rows

    def _surprise(self, rows: Rows) -> Vector:
        """Mean squared difference from what was expected over its variance, by row, shape (T,)."""
        changes = self._regressors.of(rows)
        left = self._differences(rows, changes) - changes @ self._believed.T
        covariances = self._beliefs[self._chosen].posterior.covariances
        shares = np.bincount(self._noise.levels, minlength=len(LADDER)) / len(left[0])
        doubt = np.sum((changes @ np.tensordot(shares, covariances, axes=1)) * changes, axis=1)
        return np.mean(left**2 / (self._plain_variance() + doubt[:, None]), axis=1)

    def _plain_variance(self) -> Vector:
        """Variance of a difference of readings in every mode when R is known, shape (n,) [m²]."""
        return self._noise.reading_variance * (2.0 + ground_ratio(LADDER)[self._noise.levels])

    def _without_kicks(self, rows: Rows, elapsed: int) -> tuple[Rows, int]:
        """Leave out rows that nothing explains; where they are many, R is not what it was."""
        if self._interrupted:
            rows.starts[0] = True
        kicked = self._surprise(rows) > self._settings.kick_chi2
        self._interrupted = bool(kicked[-1])
        self._kicks = max(0.0, self._kicks + float(kicked.sum()) - _USUAL_KICKS * elapsed)
        if self._kicks >= _MANY_KICKS:
            self._reopen(rows)
            return rows, 0
        for index in np.flatnonzero(kicked)[::-1]:
            rows = rows.without(int(index))
        return rows, int(kicked.sum())

    def _reopen(self, rows: Rows) -> None:
        """Forget the rows before, and widen the prior until these are no surprise."""
        self._first = self._believed.copy()
        self._kicks, self._interrupted, self._seen = 0.0, False, 0
        self._begin_tail()
        for widening in 4.0 ** np.arange(_WIDENINGS + 1):
            for belief in self._beliefs:
                belief.forget(float(widening))
            if np.median(self._surprise(rows)) < _NO_SURPRISE:
                return

    def _ask_dither(self, rows: Rows, changes: Vector, differences: Vector) -> tuple[float, float]:
        """Correlate what R̂ does not explain with what it says the dither did."""
        if not rows.dither.any():
            return 0.0, 0.0
        moved = rows.dither @ self._believed[:, : self._regressors.correctors].T
        left = differences - changes @ self._believed.T
        variance = self._plain_variance()
        return float(np.sum(moved * left / variance)), float(np.sum(moved**2 / variance))

    def _sum_up(self, theirs: Vector) -> Sums:
        if self._tail.spectrum is None:
            return no_sums(len(self._first), len(self._beliefs))
        return sums_of(
            self._tail.spectrum,
            [belief.posterior for belief in self._beliefs],
            self._chosen,
            theirs - self._first,
            self._noise,
            self._settings.kick_chi2,
        )

    def _begin_tail(self, before: Tail | None = None) -> None:
        """Begin a chunk."""
        self._tail = Tail(self._first, self._regressors.rf_place, before)
        self._sums: Sums | None = None
        self._latest: StepPosterior | None = None
        self._unsolved = 0

    def _longest_tail(self) -> int:
        """Rows of a chunk: short while R drifts quickly, for within a chunk it is one R."""
        return _QUICK if self._likely.best else LONGEST

    def _close_tail(self) -> None:
        """Take a whole chunk in for good; the next one begins with an orbit that is not known."""
        self._learn_noise()
        statistics, noise = self._tail.statistics(), self._noise
        for belief in self._beliefs:
            belief.close(statistics, noise.levels, noise.reading_variance)
        self._begin_tail(self._tail)
        self._solve()

    def _learn_noise(self) -> None:
        """Learn the noise from the rows since it was learnt last."""
        if self._counted > 0.0:
            self._noise.absorb(self._squares, self._counted)
            self._squares, self._counted = np.zeros_like(self._squares), 0.0
            self._sums = None

    def _solve_latest(self) -> StepPosterior:
        """Find the chosen posterior of all rows; what is predicted with stays as it is."""
        self._learn_noise()
        noise = self._noise
        belief = self._beliefs[self._chosen]
        self._latest = belief.solve(self._tail.statistics(), noise.levels, noise.reading_variance)
        return self._latest

    def _solve(self) -> None:
        """Learn the noise, then R under every belief, for what is predicted from now on."""
        self._learn_noise()
        tail, noise = self._tail.statistics(), self._noise
        for belief in self._beliefs:
            belief.posterior = belief.solve(tail, noise.levels, noise.reading_variance)
        self._chosen, self._sums = self._likely.best, None
        self._latest = self._beliefs[self._chosen].posterior
        self._unsolved = 0
