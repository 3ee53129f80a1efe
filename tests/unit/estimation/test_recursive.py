"""The recursive estimate: against explicit posteriors, and in closed loop where the naive fails."""

import numpy as np
import pytest

from orbitfb.core.errors import EstimationError
from orbitfb.estimation.recursive import estimate as module
from orbitfb.estimation.recursive.caution import CautiousGain
from orbitfb.estimation.recursive.estimate import RecursiveResponse
from orbitfb.estimation.recursive.said import Innovation
from orbitfb.estimation.recursive.settings import CautionSettings, RecursiveSettings

NOISE = 0.2e-6
PRIOR = 1.0
STILL = RecursiveSettings(
    reading_noise=NOISE,
    white=0.05e-6,
    minimum_gain=1e-6,
    prior_entry=PRIOR,
    drift_entry=0.0,
    groups=1,
    kick_chi2=1e12,
)


def square_response(size: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    left, _ = np.linalg.qr(rng.standard_normal((size, size)))
    right, _ = np.linalg.qr(rng.standard_normal((size, size)))
    return left @ np.diag(np.linspace(5.0, 1.0, size)) @ right


def open_loop(
    response: np.ndarray, count: int, seed: int, step: float
) -> tuple[np.ndarray, np.ndarray]:
    """Random changes that owe nothing to the readings; the orbit walks by itself, too."""
    rng = np.random.default_rng(seed)
    n, m = response.shape
    changes = 1e-6 * rng.standard_normal((count, m))
    steps = changes @ response.T + step * rng.standard_normal((count, n))
    orbit = 1e-5 * rng.standard_normal(n) + np.vstack([np.zeros(n), np.cumsum(steps, axis=0)])
    return changes, orbit + NOISE * rng.standard_normal(orbit.shape)


def feed(estimate: RecursiveResponse, changes: np.ndarray, readings: np.ndarray) -> None:
    estimate.read(readings[0])
    for change, reading in zip(changes, readings[1:], strict=True):
        estimate.predict(change)
        estimate.read(reading)


@pytest.mark.parametrize("creep", [0.0, 3e-8])
def test_equals_generalised_least_squares_on_all_readings(
    creep: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The posterior of (R, b) from the covariance of the differences, all readings at once."""
    monkeypatch.setattr(module, "_PRECISION", np.float64)
    truth = square_response(5)
    settings = STILL.model_copy(update={"creep": creep, "creep_memory": 1e30})
    changes, readings = open_loop(truth, 80, 1, settings.white)
    first = truth + 0.3
    estimate = RecursiveResponse(first, settings)
    feed(estimate, changes, readings)

    count = len(changes)
    shift = np.eye(count, k=1) + np.eye(count, k=-1)
    noise = (settings.white**2 + 2 * NOISE**2) * np.eye(count) - NOISE**2 * shift
    design = changes if creep == 0.0 else np.column_stack([changes, np.ones(count)])
    power = np.linalg.svd(first, compute_uv=False) ** 2
    level = np.exp(np.mean(np.log(power))) / np.mean(power)
    creeps = creep**2 * level + settings.creep_white**2
    prior = np.diag([PRIOR**2] * 5 + [creeps] * (creep > 0.0))
    whitened = np.linalg.solve(noise, design)
    covariance = np.linalg.inv(np.linalg.inv(prior) + design.T @ whitened)
    residual = np.diff(readings, axis=0) - changes @ first.T
    moved = (covariance @ whitened.T @ residual).T
    np.testing.assert_allclose(estimate.response, first + moved[:, :5], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(estimate.covariance, covariance[:5, :5], rtol=1e-4, atol=1e-10)
    if creep:
        np.testing.assert_allclose(estimate.modes @ estimate.creep, moved[:, 5], rtol=1e-3)


def test_the_covariance_tells_the_errors() -> None:
    """Over many rings drawn from the prior, (R̂ − R) P⁻¹ (R̂ − R)ᵀ is χ² of its size."""
    first, squares = square_response(8), []
    for seed in range(30):
        rng = np.random.default_rng([5, seed])
        truth = first + PRIOR * rng.standard_normal(first.shape)
        estimate = RecursiveResponse(first, STILL)
        feed(estimate, *open_loop(truth, 60, seed, STILL.white))
        error = estimate.response - truth
        squares.append(np.sum(error * np.linalg.solve(estimate.covariance, error.T).T))
    assert np.mean(squares) / first.size == pytest.approx(1.0, abs=0.08)


@pytest.mark.parametrize("gain", [1.0, pytest.param(0.3, marks=pytest.mark.nightly)])
def test_stays_unbiased_at_the_noise_floor_where_the_naive_estimate_does_not(gain: float) -> None:
    """With a = −g R⁻¹ y the naive estimate tends to (1/2 + 1/g) R; the filter stays at R."""
    truth = square_response(4)
    inverse = np.linalg.inv(truth)
    settings = STILL.model_copy(update={"white": 0.0, "minimum_gain": 1e-3})
    estimates = {
        known: RecursiveResponse(truth, settings.model_copy(update={"noise_model": known}))
        for known in (True, False)
    }
    last = np.zeros(4)
    rng = np.random.default_rng(3)
    orbit = np.zeros(4)
    for tick in range(12_000):
        reading = orbit + NOISE * rng.standard_normal(4)
        change = -gain * (inverse @ reading)
        orbit = orbit + truth @ change
        for estimate in estimates.values():
            if tick:
                estimate.predict(last)
            estimate.read(reading)
        last = change
    slopes = {known: float(np.trace(e.response @ inverse) / 4) for known, e in estimates.items()}
    assert slopes[False] == pytest.approx(0.5 + 1.0 / gain, rel=0.05)
    assert slopes[True] == pytest.approx(1.0, abs=0.1)


def test_a_kick_is_forgotten_by_the_orbit_and_not_learnt_by_r() -> None:
    truth = square_response(6)
    settings = STILL.model_copy(update={"kick_chi2": 25.0})
    estimate = RecursiveResponse(truth, settings)
    changes, readings = open_loop(truth, 50, 2, settings.white)
    feed(estimate, changes, readings)
    before = estimate.response
    estimate.predict(np.zeros(6))
    kicked = readings[-1] + 1e-3
    assert estimate.read(kicked).kick
    np.testing.assert_allclose(estimate.response, before)
    np.testing.assert_allclose(estimate.orbit, kicked, rtol=1e-6)


def test_surprises_in_a_row_widen_what_is_not_known() -> None:
    truth = square_response(6)
    tight = STILL.model_copy(update={"kick_chi2": 25.0, "prior_entry": 1e-4})
    estimate = RecursiveResponse(truth, tight)
    before = np.trace(estimate.covariance)
    feed(estimate, *open_loop(5.0 * truth, 200, 4, tight.white))
    assert np.trace(estimate.covariance) > 4.0 * before


def test_a_group_for_each_strength_has_a_filter_gain_for_each_mode() -> None:
    """With R known the orbit's filter is the Kalman filter of every mode, whatever the groups."""
    truth = np.diag([100.0, 30.0, 3.0, 1.0])
    settings = STILL.model_copy(
        update={"ground": 1e-6, "prior_entry": 1e-12, "white": 0.0, "groups": 2}
    )
    estimate = RecursiveResponse(truth, settings)
    assert len(estimate.groups) == 2
    _, readings = open_loop(truth, 300, 6, 1e-7)
    feed(estimate, np.zeros((300, 4)), readings)
    steps = settings.ground**2 * np.diag(truth) ** 2 / np.mean(np.diag(truth) ** 2)
    expected, variance = readings[0], np.full(4, NOISE**2)
    for reading in readings[1:]:
        gain = (variance + steps) / (variance + steps + NOISE**2)
        expected = expected + gain * (reading - expected)
        variance = gain * NOISE**2
    np.testing.assert_allclose(estimate.orbit, expected, rtol=1e-4)


def test_the_gain_is_the_inverse_where_r_is_known_and_fades_where_it_is_not() -> None:
    truth = square_response(6)
    orbit = np.ones(6)
    exact = CautiousGain(
        RecursiveResponse(truth, STILL.model_copy(update={"prior_entry": 1e-9})), CautionSettings()
    )
    np.testing.assert_allclose(exact.far, np.linalg.inv(truth), rtol=1e-5)
    np.testing.assert_allclose(exact.near, np.linalg.inv(truth), rtol=1e-5)
    vague = CautiousGain(
        RecursiveResponse(truth, STILL.model_copy(update={"prior_entry": 100.0})), CautionSettings()
    )
    assert np.linalg.norm(vague.far @ orbit) < 0.01 * np.linalg.norm(exact.far @ orbit)


def test_both_gains_are_renewed_in_turn_and_never_at_one_tick() -> None:
    estimate = RecursiveResponse(square_response(4), STILL)
    gain = CautiousGain(estimate, CautionSettings(period=10, events=False, far=1e9))
    said, renewed = Innovation(chi2=1.0, doubt=0.0, kick=False), {"near": [], "far": []}
    for tick in range(40):
        near, far = gain.near_modes, gain.far_modes
        gain.follow_in_turn(said)
        renewed["near"] += [tick] if gain.near_modes is not near else []
        renewed["far"] += [tick] if gain.far_modes is not far else []
    assert renewed == {"near": [9, 19, 29, 39], "far": [4, 14, 24, 34]}


def test_the_cautious_gain_minimises_the_expected_orbit() -> None:
    """Against the mean over rings drawn from the posterior, all modes weighed alike."""
    truth = square_response(4)
    estimate = RecursiveResponse(truth, STILL.model_copy(update={"prior_entry": 0.7}))
    gain = CautiousGain(estimate, CautionSettings(caution=1.0, longest=1.0)).far
    rng = np.random.default_rng(8)
    rings = truth + 0.7 * rng.standard_normal((20_000, 4, 4))
    orbit = rng.standard_normal(4)
    stacked = rings.reshape(-1, 4)
    best = np.linalg.lstsq(stacked, -np.tile(orbit, len(rings)), rcond=None)[0]
    np.testing.assert_allclose(-gain @ orbit, best, rtol=0.05, atol=0.01)


def test_a_response_that_is_not_one_is_refused() -> None:
    with pytest.raises(EstimationError, match="finite matrix"):
        RecursiveResponse(np.full((3, 3), np.nan), STILL)


def test_the_creep_grows_and_turns_with_what_is_held() -> None:
    """R drifts in a straight line, and the currents grow along one direction, then another."""
    size, ticks = 12, 3000
    generator = np.random.default_rng(8)
    truth, slope = square_response(size), 1e-4 * generator.standard_normal((size, size))
    settings = STILL.model_copy(
        update={
            "prior_entry": 1e-3,
            "drift_entry": 1e-4 * np.sqrt(ticks),
            "creep": 1e-12,
            "creep_white": 1e-10,
            "drift_every": 10,
        }
    )
    sides = np.linalg.qr(generator.standard_normal((size, 2)))[0].T
    missed = {}
    for held in (None, 1e-6):
        estimate = RecursiveResponse(truth, settings.model_copy(update={"creep_held": held}))
        rng = np.random.default_rng(2)
        orbit, currents, errors = np.zeros(size), np.zeros(size), []
        for tick in range(ticks):
            orbit = orbit + slope @ currents + settings.white * rng.standard_normal(size)
            estimate.read(orbit + NOISE * rng.standard_normal(size))
            change = 1e-6 * (rng.standard_normal(size) + 0.3 * sides[int(tick > ticks // 2)])
            estimate.predict(change)
            orbit = orbit + (truth + tick * slope) @ change
            currents = currents + change
            creep = slope @ currents
            errors.append(
                np.linalg.norm(estimate.modes @ estimate.creep - creep) / np.linalg.norm(creep)
            )
        missed[held] = [float(np.median(part)) for part in np.split(np.array(errors), 10)]
    assert min(missed[None]) > 0.9
    assert max(missed[1e-6][3:]) < 0.35  # the currents turn in the middle
