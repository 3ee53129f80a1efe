"""The RF as one more column of the response that is tracked at every tick."""

import numpy as np
import pytest

from orbitfb.core.errors import EstimationError
from orbitfb.core.ports import inform
from orbitfb.estimation.columns import KnownRf
from orbitfb.estimation.recursive.estimate import RecursiveResponse
from orbitfb.estimation.recursive.settings import RecursiveSettings
from orbitfb.policies.adaptive import AdaptivePolicy
from orbitfb.policies.adaptive_settings import AdaptiveSettings
from orbitfb.policies.masking import MaskedPolicy

NOISE, STEP, N, M, COUNT = 0.2e-6, 0.05e-6, 5, 4, 90
STILL = RecursiveSettings(
    reading_noise=NOISE,
    white=STEP,
    minimum_gain=1e-6,
    prior_entry=1e-4,
    drift_entry=0.0,
    groups=1,
    kick_chi2=1e12,
)


def ring():
    generator = np.random.default_rng(3)
    matrix = 1e-3 * generator.standard_normal((N, M))
    told = 1e-6 * (1.0 + 0.2 * generator.standard_normal(N))
    energy = 100.0 * generator.standard_normal(M)
    return generator, matrix, KnownRf(told, energy)


def test_equals_generalised_least_squares_with_the_column():
    generator, truth, rf = ring()
    column = 1.15 * rf.response
    changes = 1e-3 * generator.standard_normal((COUNT, M))
    hertz = generator.standard_normal(COUNT) * (np.arange(COUNT) % 3 == 0)
    steps = (
        changes @ truth.T + np.outer(hertz, column) + STEP * generator.standard_normal((COUNT, N))
    )
    readings = np.vstack([np.zeros(N), np.cumsum(steps, axis=0)])
    readings = readings + NOISE * generator.standard_normal(readings.shape)
    first = truth + 5e-5
    estimate = RecursiveResponse(first, STILL, rf=rf)
    estimate.read(readings[0])
    for change, step, reading in zip(changes, hertz, readings[1:], strict=True):
        estimate.predict(change, step)
        estimate.read(reading)

    unit = np.linalg.norm(first) / np.sqrt(M) / np.linalg.norm(rf.response)
    design = np.column_stack([changes, hertz / unit])
    size = np.mean((unit * rf.response) ** 2) * STILL.rf_error**2
    dispersive = 2.0 * rf.energy / unit
    prior = np.diag([STILL.prior_entry**2] * M + [size])
    prior[:M, :M] += size * np.outer(dispersive, dispersive)
    shift = np.eye(COUNT, k=1) + np.eye(COUNT, k=-1)
    noise = (STEP**2 + 2 * NOISE**2) * np.eye(COUNT) - NOISE**2 * shift
    whitened = np.linalg.solve(noise, design)
    covariance = np.linalg.inv(np.linalg.inv(prior) + design.T @ whitened)
    left = np.diff(readings, axis=0) - design @ np.column_stack([first, unit * rf.response]).T
    moved = (covariance @ whitened.T @ left).T
    np.testing.assert_allclose(estimate.response, first + moved[:, :M], rtol=1e-5, atol=1e-9)
    found = rf.response + moved[:, M] / unit
    np.testing.assert_allclose(estimate.column, found, rtol=1e-5)
    np.testing.assert_allclose(estimate.covariance, covariance[:M, :M], rtol=1e-4, atol=1e-14)
    assert np.linalg.norm(found - column) < 0.5 * np.linalg.norm(rf.response - column)


def test_a_column_that_does_not_fit_is_refused():
    _, matrix, rf = ring()
    with pytest.raises(EstimationError, match="an RF column of shape"):
        RecursiveResponse(matrix, STILL, rf=KnownRf(rf.response[1:], rf.energy))


def law(rf, track=True):
    _, matrix, _ = ring()
    tracking = {"white": STEP, "prior_entry": 1e-6, "prior_relative": 1e-3, "drift_entry": 0.0}
    settings = AdaptiveSettings.model_validate({"tracking": tracking, "track_rf": track})
    policy = AdaptivePolicy(matrix, settings)
    policy.rf = rf
    return MaskedPolicy(policy, matrix, np.ones(M, dtype=bool)), matrix


def test_the_law_that_learns_tracks_the_column_and_keeps_it():
    generator, _, rf = ring()
    policy, matrix = law(rf)
    assert policy.learns_rf and policy.rf is rf
    column, every = 1.15 * rf.response, np.ones(N, dtype=bool)
    state, orbit = policy.initial_state(), np.zeros(N)
    for tick in range(300):
        hertz = float(tick % 3 == 0) * generator.standard_normal()
        reading = orbit + NOISE * generator.standard_normal(N)
        change, state = policy.act(reading, every, state)
        state = inform(policy, reading, every, change, state, hertz)
        orbit = orbit + matrix @ change + hertz * column + STEP * generator.standard_normal(N)
    for estimate in (state.estimate, policy.initial_state().estimate):
        assert np.linalg.norm(estimate.column - column) < 0.3 * np.linalg.norm(rf.response - column)
    np.testing.assert_array_equal(policy.rf.response, rf.response)
    for deaf, _ in (law(None), law(rf, track=False)):
        assert not deaf.learns_rf and deaf.initial_state().estimate.column is None
    assert not AdaptiveSettings().track_rf
