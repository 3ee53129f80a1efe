"""Sums of steps at the nodes of λ: against the whole covariance, and in a closed loop."""

import numpy as np
import pytest

from orbitfb.core.errors import EstimationError
from orbitfb.estimation.statistics import (
    NODES,
    StepSpectrum,
    StepStatistics,
    node_weights,
    solve,
)

NOISE = 0.2e-6
RATIOS = np.array([1e-4, 0.02, 0.5, 5.0])


def steps_of(count, response, changes, ratio, generator):
    ground = NOISE * np.sqrt(ratio) * generator.standard_normal((count, len(response)))
    noise = NOISE * generator.standard_normal((count + 1, len(response)))
    return changes @ response.T + ground + np.diff(noise, axis=0)


def test_weights_of_the_nodes_hit_every_noise():
    eigenvalue = np.geomspace(NODES[0], 4.0, 700)
    place = np.log2(eigenvalue / NODES[0])
    low = np.minimum(place.astype(int), len(NODES) - 2)
    share = place - low
    for ratio, weight in zip(RATIOS, node_weights(RATIOS), strict=True):
        met = ((1.0 - share) * weight[low] + share * weight[low + 1]) * (ratio + eigenvalue)
        assert np.max(np.abs(met - 1.0)) < 0.05
        assert np.mean(met) == pytest.approx(1.0, abs=1e-3)


def test_sums_give_the_posterior_of_the_whole_covariance():
    generator = np.random.default_rng(0)
    response = 1e-3 * generator.standard_normal((4, 3))
    changes = 1e-3 * generator.standard_normal((150, 3))
    starts = np.isin(np.arange(150), [0, 60])
    steps = np.concatenate(
        [
            steps_of(60, response, changes[:60], 0.02, generator),
            steps_of(90, response, changes[60:], 0.02, generator),
        ]
    )
    statistics = StepStatistics(3, 4)
    statistics.take(StepSpectrum.of(changes, steps, starts))
    prior, levels = 1e-8 * np.eye(3), np.full(4, 1)
    found = solve([statistics], prior, node_weights(RATIOS), levels, NOISE**2)
    information, pull = np.linalg.inv(prior), np.zeros((3, 4))
    for part in (slice(0, 60), slice(60, 150)):
        size = part.stop - part.start
        covariance = (2.02 * np.eye(size) - np.eye(size, k=1) - np.eye(size, k=-1)) * NOISE**2
        information = information + changes[part].T @ np.linalg.solve(covariance, changes[part])
        pull = pull + changes[part].T @ np.linalg.solve(covariance, steps[part])
    expected = np.linalg.inv(information)
    sigma = np.sqrt(np.diag(expected))
    assert np.allclose(found.covariances[1], expected, rtol=0.02, atol=0.02 * expected.max())
    assert np.all(np.abs(found.rows - (expected @ pull).T) < 0.05 * sigma)
    assert np.array_equal(found.covariances[0], prior)


@pytest.mark.parametrize("gain", [0.3, 1.0])
def test_noise_that_the_loop_writes_into_its_changes_does_no_harm(gain):
    """One mode, y read, a = −g y: the naive slope would be 1/2 + 1/g."""
    generator = np.random.default_rng(1)
    count, chunks, ratio = 511, 60, 0.05
    orbit, changes, readings = 0.0, [], []
    for _ in range(count * chunks + 1):
        readings.append(orbit + NOISE * generator.standard_normal())
        changes.append(-gain * readings[-1])
        orbit += changes[-1] + NOISE * np.sqrt(ratio) * generator.standard_normal()
    differences = np.diff(readings)[:, None]
    regressors = np.array(changes[:-1])[:, None]
    statistics = StepStatistics(1, 1)
    for begin in range(0, count * chunks, count):
        piece = slice(begin, begin + count)
        starts = np.arange(count) == 0
        statistics.take(StepSpectrum.of(regressors[piece], differences[piece], starts))
    weights = node_weights(np.array([ratio]))
    found = solve([statistics], 100.0 * np.eye(1), weights, np.zeros(1, dtype=int), NOISE**2)
    sigma = float(np.sqrt(found.covariances[0, 0, 0]))
    naive = float(regressors[:, 0] @ differences[:, 0] / np.sum(regressors**2))
    assert naive > 1.2
    assert found.rows[0, 0] == pytest.approx(1.0, abs=0.005 + 3.0 * sigma)


def test_what_is_not_finite_is_said():
    statistics = StepStatistics(2, 2)
    statistics.sums[:] = np.nan
    with pytest.raises(EstimationError, match="not a finite positive number"):
        solve([statistics], np.eye(2), node_weights(RATIOS), np.zeros(2, dtype=int), 1.0)
