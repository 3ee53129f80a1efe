"""What is believed of R under a slow drift and a quick one, and which is likelier."""

import numpy as np
import pytest

from orbitfb.estimation.statistics import StepSpectrum, StepStatistics
from orbitfb.models.belief import SLOW, Following, Keeping, Likelihoods

NOISE = 1e-3
LEVELS = np.full(1, 6)


def chunk(response, size, seed):
    """A hundred rows of one corrector and one mode."""
    generator = np.random.default_rng(seed)
    changes = size * generator.standard_normal((100, 1))
    steps = response * changes + np.diff(NOISE * generator.standard_normal((101, 1)), axis=0)
    statistics = StepStatistics(1, 1)
    statistics.take(StepSpectrum.of(changes, steps, np.arange(100) == 0))
    return statistics


def slope(belief, tail):
    posterior = belief.solve(tail, LEVELS, NOISE**2)
    return float(posterior.rows[0, 0]), float(np.sqrt(posterior.covariances[6, 0, 0]))


def test_old_rows_however_loud_do_not_hold_what_drifts_quickly():
    """The orbit at the closing moved the correctors 100 times as far as all that came later."""
    prior, drift = np.eye(1), 1e-4 * np.eye(1)
    beliefs = Keeping(prior, SLOW**2 * drift, 1, 16_000.0), Following(prior, drift, 1)
    loud, later, nothing = chunk(1.0, 1.0, 1), chunk(1.2, 0.01, 2), StepStatistics(1, 1)
    for belief in beliefs:
        for part in (loud, later):
            belief.pass_ticks(400)
            belief.close(part, LEVELS, NOISE**2)
    (kept, _), (followed, sigma) = (slope(belief, nothing) for belief in beliefs)
    assert kept == pytest.approx(1.0, abs=0.01)
    assert followed == pytest.approx(1.2, abs=3.0 * sigma)
    assert sigma < 0.05


def test_an_open_tail_counts_like_a_closed_one():
    for belief in (
        Keeping(np.eye(1), np.zeros((1, 1)), 1, 1e12),
        Following(np.eye(1), np.zeros((1, 1)), 1),
    ):
        rows = chunk(0.7, 0.1, 3)
        open_tail = slope(belief, rows)
        belief.close(rows, LEVELS, NOISE**2)
        assert slope(belief, StepStatistics(1, 1)) == pytest.approx(open_tail)


def test_the_likelier_belief_wins_and_can_be_won_back():
    likely = Likelihoods(2, 1000.0)
    assert likely.best == 0
    likely.follow(np.array([-10.0, 0.0]), 100)
    assert likely.best == 1
    likely.follow(np.array([0.0, -1e6]), 100)
    likely.follow(np.array([-10.0, 0.0]), 100)
    assert likely.best == 1
