"""What is believed about R if it drifts slowly, and what if quickly; which is likelier.

All are posteriors of one regression (`orbitfb.estimation.statistics`) around the first R̂, and
differ in the size of the drift Q per tick:

- `Keeping`: a slow one. All rows are one regression; the prior grows by Q per tick, a row counts
  1/e after `memory` rows, and on average R has moved by Q over half of the memory since the rows
  that count. A ring that seems to rest is not believed to rest for ever: a kick that was answered
  once tells some directions so well that nothing since has tested them.
- `Following`: a quick one. R walks at random, chunk by chunk: what was known of it before a chunk,
  less certain by Q per tick, is the prior of the next one (the filter of R. Kalman, J. Basic Eng.
  82 (1960) 35), so that no old row, however loud, holds R̂ where it was. There are two, the one
  half as quick in logarithms: too small a Q claims to know what has moved since, and too large a
  one knows so little of R that caution takes the gain away.

Each predicts the next rows before they are used. The logarithms of their probabilities move by the
log densities of these; besides, R may change its ways once in `memory` rows (the forward recursion
of a hidden Markov chain, L. Rabiner, Proc. IEEE 77 (1989) 257). So the forgetting follows what was
measured: a ring at rest is known better with every row for long, and little that the noise alone
does to R̂ asks for another policy.
"""

import numpy as np

from orbitfb.core.errors import EstimationError
from orbitfb.core.signals import Vector
from orbitfb.estimation.columns import Columns
from orbitfb.estimation.statistics import (
    StepPosterior,
    StepStatistics,
    follow,
    node_weights,
    solve,
)
from orbitfb.estimation.transform import Indices
from orbitfb.models.filter import ground_ratio
from orbitfb.models.noise import LADDER
from orbitfb.models.settings import IdentifySettings

WEIGHTS = node_weights(ground_ratio(LADDER))
"""Of the nodes of λ at every level of the ladder, shape (levels, nodes)."""

SLOW = 1 / 8
"""Slow drift over the quick one, rms [1]: with the defaults 1.25 % in 10,000 ticks, what
temperatures do to gains and optics of a healthy ring in a quarter of an hour, which a loop at its
noise floor cannot show."""


class Keeping:
    """The posterior of R − R̂₀ from all rows, if R drifts slowly.

    Args:
        prior: Covariance of a row in the beginning, shape (k, k) [(m/A)²].
        drift: What a tick adds to it, shape (k, k).
        modes: Count n.
        memory: Rows after which a row counts 1/e; inf: it counts for ever.

    Attributes:
        posterior: What rows are predicted with.
    """

    def __init__(self, prior: Vector, drift: Vector, modes: int, memory: float) -> None:
        self._prior, self._drift, self._memory = prior, drift, memory
        self._modes = modes
        self.forget(1.0)

    def forget(self, widening: float) -> None:
        """Begin anew with a prior that is so many times as wide."""
        self._widened = widening * self._prior
        self._ticks = 0
        self._statistics = StepStatistics(len(self._prior), self._modes)
        rows = np.zeros((self._modes, len(self._prior)))
        self.posterior = StepPosterior(rows, np.repeat(self._widened[None], len(LADDER), axis=0))

    def pass_ticks(self, count: int) -> None:
        """Let R drift for some ticks."""
        self._ticks += count

    @property
    def unseen(self) -> Vector:
        """Covariance that a row would have if nothing had been seen, shape (k, k)."""
        return self._widened + self._ticks * self._drift

    @property
    def moved(self) -> Vector:
        """What R has moved by since the rows that count, on average, shape (k, k)."""
        return 0.5 * min(self._ticks, self._memory) * self._drift

    def close(self, statistics: StepStatistics, levels: Indices, variance: float) -> None:
        """Take rows in for good; arguments as those of `solve`."""
        self._statistics.fade(float(np.exp(-statistics.rows / self._memory)))
        self._statistics.add(statistics)

    def solve(self, tail: StepStatistics, levels: Indices, variance: float) -> StepPosterior:
        """Give the posterior of all rows.

        Args:
            tail: Of rows that were not taken in for good.
            levels: Level of every mode, shape (n,).
            variance: Of the reading noise [m²].
        """
        prior = self.unseen
        parts = (self._statistics, tail) if tail.rows else (self._statistics,)
        found = solve(parts, prior, WEIGHTS, levels, variance)
        return StepPosterior(found.rows, found.covariances + self.moved)


class Following:
    """The posterior of R − R̂₀ if R drifts quickly.

    Args:
        prior: Covariance of a row in the beginning, shape (k, k) [(m/A)²].
        drift: What a tick adds to it, shape (k, k).
        modes: Count n.

    Attributes:
        posterior: What rows are predicted with.
    """

    def __init__(self, prior: Vector, drift: Vector, modes: int) -> None:
        self._prior, self._drift, self._modes = prior, drift, modes
        self.forget(1.0)

    def forget(self, widening: float) -> None:
        """Begin anew with a prior that is so many times as wide."""
        rows = np.zeros((self._modes, len(self._prior)))
        self._widened, self._age = widening * self._prior, 0
        covariances = np.repeat(self._widened[None], len(LADDER), axis=0)
        self._known = self.posterior = StepPosterior(rows, covariances)
        self._ticks = 0

    def pass_ticks(self, count: int) -> None:
        """Let R drift for some ticks."""
        self._ticks += count
        self._age += count

    @property
    def unseen(self) -> Vector:
        """Covariance that a row would have if nothing had been seen, shape (k, k)."""
        return self._widened + self._age * self._drift

    @property
    def moved(self) -> Vector:
        """Nothing: what R has moved by is in its covariance, shape (k, k)."""
        return np.zeros_like(self._drift)

    def close(self, statistics: StepStatistics, levels: Indices, variance: float) -> None:
        """Take rows in for good; arguments as those of `solve`."""
        self._known = self.solve(statistics, levels, variance)
        self._ticks = 0

    def solve(self, tail: StepStatistics, levels: Indices, variance: float) -> StepPosterior:
        """Give the posterior of all rows.

        Args:
            tail: Of rows that were not taken in for good.
            levels: Level of every mode, shape (n,).
            variance: Of the reading noise [m²].
        """
        moved = self._known.covariances + self._ticks * self._drift
        before = StepPosterior(self._known.rows, moved)
        return follow(tail, before, WEIGHTS, levels, variance) if tail.rows else before


def make_beliefs(
    columns: Columns, response: Vector, settings: IdentifySettings
) -> tuple[Keeping, Following, Following]:
    """Say what is believed before there are rows: a slow drift, a quicker one, and a quick one.

    Args:
        columns: The actuators.
        response: R̂₀ with the column of the RF, if that is one, shape (n, actuators) [m/A].
        settings: Prior, drift, memory.

    Raises:
        EstimationError: Prior and drift are zero.
    """
    modes, count = response.shape
    prior = columns.prior(
        response, settings.prior_entry, settings.prior_relative, settings.rf_error
    )
    drift = columns.prior(response, settings.drift_entry, settings.drift_relative, 0.0)
    if settings.prior_entry == settings.prior_relative == 0.0:
        raise EstimationError("prior_entry and prior_relative are both 0: nothing can be learnt")
    prior += 1e-12 * np.trace(prior) / count * np.eye(count)
    prior = _bordered(prior, settings.creep**2)
    drift = _bordered(drift, settings.creep**2 / settings.creep_memory)
    # The memory goes with 1/√Q, the time in which a scalar Kalman filter forgets.
    keeping = Keeping(prior, SLOW**2 * drift, modes, settings.memory / SLOW)
    between = Following(prior, SLOW * drift, modes)  # √SLOW in rms: half way in logarithms
    return keeping, between, Following(prior, drift, modes)


def _bordered(covariance: Vector, creep: float) -> Vector:
    """Add the variance of the creep as the last coefficient."""
    size = len(covariance)
    whole = np.zeros((size + 1, size + 1))
    whole[:size, :size] = covariance
    whole[size, size] = creep
    return whole


class Likelihoods:
    """How likely every belief is.

    Args:
        count: How many beliefs; the first is believed at first.
        memory: Rows in which R changes its ways once.

    Attributes:
        log: Logarithms of the probabilities, shape (count,) [nats].
    """

    def __init__(self, count: int, memory: float) -> None:
        self._memory = memory
        self.log = np.full(count, -np.log(memory))
        self.log[0] = np.log1p(-(count - 1) / memory)

    @property
    def best(self) -> int:
        """The likeliest belief."""
        return int(np.argmax(self.log))

    def follow(self, densities: Vector, rows: float) -> None:
        """Take in what rows say.

        Args:
            densities: Log density of them under every belief, shape (count,) [nats].
            rows: How many they are.
        """
        likely = self.log + densities
        likely = np.exp(likely - likely.max())
        likely /= likely.sum()
        changed = -float(np.expm1(-rows / self._memory))
        mixed = (1.0 - changed) * likely + changed * (1.0 - likely) / (len(likely) - 1)
        self.log = np.log(mixed)
