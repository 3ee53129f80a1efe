"""The likelihood of steps in sine transform against dense covariances, and the floor's estimate."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import norm

from orbitfb.core.errors import EstimationError
from orbitfb.estimation.colour import rarity
from orbitfb.estimation.evidence import NormalPriors, NormalTerms, normal_size
from orbitfb.estimation.floor import first_noise, foretold, improve, trusted
from orbitfb.estimation.moments import Moments
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.prediction import predicted
from orbitfb.estimation.priors import LARGEST, OCTAVES, PER_OCTAVE
from orbitfb.estimation.shapes import Shapes, fit_shaken, fit_shapes
from orbitfb.estimation.transform import Matrix, StepTransform

STARTS = np.zeros(23, dtype=np.bool_)
STARTS[[0, 9]] = True


def a_noise(rng: np.random.Generator, count: int = 4) -> StepNoise:
    root = rng.standard_normal((count, count))
    return StepNoise(0.3 * root @ root.T, np.diag(rng.uniform(0.5, 2.0, count)))


def dense_covariance(noise: StepNoise, starts: np.ndarray) -> np.ndarray:
    """Covariance of all steps, row by row, from the definition Δz_n = w_n + v_n − v_{n−1}."""
    rows = len(starts)
    steps = [row for row in range(rows) if not starts[row]]
    difference = np.zeros((len(steps), rows))
    for number, row in enumerate(steps):
        difference[number, row], difference[number, row - 1] = 1.0, -1.0
    shaken = np.kron(difference @ difference.T, noise.white)
    return shaken + np.kron(np.eye(len(steps)), noise.walk)


def dense_log_density(values: np.ndarray, covariance: np.ndarray) -> float:
    log_det = np.linalg.slogdet(2.0 * np.pi * covariance)[1]
    return float(-0.5 * (values @ np.linalg.solve(covariance, values) + log_det))


def test_the_likelihood_is_that_of_the_dense_covariance() -> None:
    rng = np.random.default_rng(1)
    noise, transform = a_noise(rng), StepTransform.of(STARTS, None, exact=True)
    readings = rng.standard_normal((len(STARTS), 4)).cumsum(axis=0)
    covariance = dense_covariance(noise, STARTS)
    expected = dense_log_density(transform.steps(readings).ravel(), covariance)
    found = noise.log_likelihood(transform.spectrum(readings), transform)
    assert found == pytest.approx(expected, abs=1e-8)


def test_the_evidence_of_terms_is_that_of_the_dense_covariance() -> None:
    """Terms with normal priors are a covariance too: the marginal density is one Gaussian."""
    rng = np.random.default_rng(2)
    noise, transform = a_noise(rng), StepTransform.of(STARTS, None, exact=True)
    readings = rng.standard_normal((len(STARTS), 4)).cumsum(axis=0)
    patterns = rng.standard_normal((4, 3))
    courses = rng.standard_normal((len(STARTS), 3)).cumsum(axis=0)
    variance = np.array([0.5, 0.0, 2.0])
    steps = transform.steps(courses)
    columns = np.stack([np.outer(steps[:, k], patterns[:, k]).ravel() for k in range(3)], axis=1)
    covariance = dense_covariance(noise, STARTS)
    values = transform.steps(readings).ravel()
    wide = covariance + (columns * variance) @ columns.T
    expected = dense_log_density(values, wide) - dense_log_density(values, covariance)
    spectrum = transform.spectrum(courses)
    pulled = noise.pull(transform.spectrum(readings), transform)
    pull = np.einsum("fk,fk->k", pulled @ patterns, spectrum)
    weights = noise.precision(transform, patterns)
    information = sum(
        weight * (spectrum[transform.members(band)].T @ spectrum[transform.members(band)])
        for band, weight in enumerate(weights)
    )
    terms = NormalTerms(pull, information, variance)
    assert terms.evidence() == pytest.approx(expected, abs=1e-8)
    one = NormalTerms(pull, information, np.array([0.5, 0.0, 0.0])).evidence()
    assert one == pytest.approx(normal_size(pull[:1], np.diag(information)[:1], 0.5)[0], abs=1e-9)


def test_terms_that_are_marginalised_weaken_others_as_in_the_dense_covariance() -> None:
    rng = np.random.default_rng(3)
    both = rng.standard_normal((3, 12))
    information = both @ both.T
    pull = rng.standard_normal(3)
    variance = np.array([0.7, 0.2, 0.0])
    its, cross = NormalPriors.of(information[:2, :2], variance[:2]), information[:2, 2:]
    a = pull[2:] - cross.T @ its.mean(pull[:2])
    h = its.beyond(information[2:, 2:], cross)
    with_third = NormalTerms(pull, information, np.array([0.7, 0.2, 1.3])).evidence()
    without = NormalTerms(pull, information, variance).evidence()
    assert with_third - without == pytest.approx(normal_size(a, h[0], 1.3)[0], abs=1e-9)


def test_a_cut_for_speed_keeps_every_step() -> None:
    starts = np.zeros(3001, dtype=np.bool_)  # 3000 steps, and 3001 is prime
    starts[0] = True
    transform = StepTransform.of(starts)
    assert len(transform) == 3000
    assert [part.stop - part.start for part in transform.pieces] == [2999, 1]
    values = np.random.default_rng(4).standard_normal((3000, 2))
    assert np.allclose(transform.turn(transform.turn(values)), values)


def test_the_prediction_is_the_conditional_mean_of_the_dense_covariance() -> None:
    rng = np.random.default_rng(5)
    noise = a_noise(rng, 2)
    starts = np.zeros(6, dtype=np.bool_)
    starts[0] = True
    transform = StepTransform.of(starts, exact=True)
    readings = rng.standard_normal((6, 2)).cumsum(axis=0)
    found = predicted(readings, noise, transform)
    wide = 1e9 * np.eye(2)  # nothing is known of the orbit before the first row
    orbit = np.kron(np.ones((6, 6)), wide)
    orbit += np.kron(np.minimum.outer(np.arange(6), np.arange(6)), noise.walk)
    seen = orbit[:10, :10] + np.kron(np.eye(5), noise.white)
    expected = orbit[10:, :10] @ np.linalg.solve(seen, readings[:5].ravel())
    assert found[5] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("moved", [0.0, 50.0])
def test_the_first_row_is_told_without_its_own_noise(moved: float) -> None:
    """But where the orbit has moved since, as after a loop was closed, it is where it was read."""
    rng = np.random.default_rng(11)
    starts = np.arange(400) == 0
    noise = StepNoise(0.01**2 * np.eye(30), np.eye(30))
    orbit = 0.01 * rng.standard_normal((400, 30)).cumsum(axis=0)
    orbit[0] += moved
    readings = orbit + rng.standard_normal(orbit.shape)
    found = predicted(readings, noise, StepTransform.of(starts))
    wrong = float(np.sqrt(np.mean((found[0] - orbit[0]) ** 2)))
    assert wrong < 0.3 if not moved else 0.7 < wrong < 1.3


def test_the_floor_is_found_where_the_walk_is_small() -> None:
    """A walk a fifth of the noise: expectation maximisation alone stays thousands of nats off."""
    rng = np.random.default_rng(6)
    count, rows = 24, 2001
    root = rng.standard_normal((count, 8))
    walk = 0.04**2 * (root @ root.T + np.eye(count)) / 9.0
    sigma = 0.2 * rng.uniform(0.3, 3.0, count)
    orbit = rng.multivariate_normal(np.zeros(count), walk, rows).cumsum(axis=0)
    readings = orbit + sigma * rng.standard_normal((rows, count))
    starts = np.zeros(rows, dtype=np.bool_)
    starts[0] = True
    transform = StepTransform.of(starts)
    families = [root @ root.T, np.eye(count)]
    begin = first_noise(transform.steps(readings), families[0])
    moments = Moments.of(transform.spectrum(readings), transform)
    found, _ = fit_shapes(
        begin, moments, Shapes(tuple(families), np.zeros((len(walk), 0))), np.zeros_like(walk)
    )
    assert np.sqrt(np.diag(found.white)) == pytest.approx(sigma, rel=0.08)
    assert np.sqrt(np.trace(found.walk)) == pytest.approx(np.sqrt(np.trace(walk)), rel=0.15)
    freer = improve(found, moments, found.walk, 4, 100.0)
    spectrum = transform.spectrum(readings)
    assert freer.log_likelihood(spectrum, transform) > found.log_likelihood(spectrum, transform)


@pytest.mark.parametrize(("strange", "trust"), [(0.0, 1000.0), (1.0, 100.0)])
def test_the_shapes_of_the_walk_are_trusted_as_far_as_one_half_foretells_the_other(
    strange: float, trust: float
) -> None:
    """A walk that is of the shapes, and one with eight orbits that none of them has."""
    rng = np.random.default_rng(7)
    count, rows = 24, 2001
    root, other = rng.standard_normal((count, 8)), rng.standard_normal((count, 8))
    walk = 0.1**2 * (root @ root.T + strange * other @ other.T + 0.1 * np.eye(count))
    orbit = rng.multivariate_normal(np.zeros(count), walk, rows).cumsum(axis=0)
    readings = orbit + 0.2 * rng.standard_normal((rows, count))
    starts = np.zeros(rows, dtype=np.bool_)
    starts[0] = True
    transform = StepTransform.of(starts)
    spectrum = transform.spectrum(readings)
    moments = Moments.of(spectrum, transform)
    shapes = Shapes((root @ root.T, np.eye(count)), np.zeros((count, 0)))
    begin = first_noise(transform.steps(readings), shapes.broad[0])
    mixed, _ = fit_shapes(begin, moments, shapes, np.zeros_like(walk))
    halves = Moments.halves(spectrum, transform, np.zeros_like(moments.total))
    assert halves[0].total + halves[1].total == pytest.approx(moments.total)
    assert trusted(mixed, halves, (100.0, 300.0, 1000.0)) == trust


@pytest.mark.parametrize(("more", "uneven"), [(1.0, False), (40.0, True)])
def test_one_body_that_walks_more_is_foretold_by_shapes_that_have_it(
    more: float, uneven: bool
) -> None:
    rng = np.random.default_rng(8)
    count, rows = 24, 2001
    bodies = rng.standard_normal((count, 60)) / np.sqrt(count)
    steps = rng.standard_normal((rows, 60)) * np.where(np.arange(60) == 17, np.sqrt(more), 1.0)
    readings = 0.1 * (steps @ bodies.T).cumsum(axis=0) + 0.2 * rng.standard_normal((rows, count))
    starts = np.zeros(rows, dtype=np.bool_)
    starts[0] = True
    transform = StepTransform.of(starts)
    shapes = Shapes((bodies @ bodies.T, np.eye(count)), bodies, 60)
    begin = first_noise(transform.steps(readings), shapes.broad[0])
    halves = Moments.halves(transform.spectrum(readings), transform)
    held, weights, choices = np.zeros((count, count)), np.zeros(0), (np.inf, 300.0)
    even, _ = foretold(begin, halves, shapes.even, held, weights, choices)
    freely, _ = foretold(begin, halves, shapes, held, weights, choices)
    assert (freely > even + 10.0) == uneven


@pytest.mark.parametrize(
    ("steps", "said"),
    [
        (np.ones((30, 3)), "30 steps from row to row are too few"),
        (np.zeros((60, 3)), "read the same"),
    ],
)
def test_a_floor_that_cannot_be_told_says_why(steps: np.ndarray, said: str) -> None:
    with pytest.raises(EstimationError, match=said):
        first_noise(steps, np.eye(3))


def test_courses_come_back_from_their_spectrum() -> None:
    rng = np.random.default_rng(9)
    starts = np.zeros(90, dtype=np.bool_)
    starts[[0, 40]] = True
    transform = StepTransform.of(starts)
    courses = rng.standard_normal((90, 2)).cumsum(axis=0)
    back = transform.summed(transform.spectrum(courses))
    assert back[:40] == pytest.approx(courses[:40] - courses[0])
    assert back[40:] == pytest.approx(courses[40:] - courses[40])


def test_a_free_walk_climbs_at_every_step_and_comes_close_to_the_truth() -> None:
    """Small beside the noise it is what expectation maximisation finds only after dozens."""
    rng = np.random.default_rng(11)
    count, rows = 6, 2001
    root = rng.standard_normal((count, count))
    truth = StepNoise(0.02 * root @ root.T, np.diag(rng.uniform(0.5, 2.0, count)))
    starts = np.zeros(rows, dtype=np.bool_)
    starts[0] = True
    transform = StepTransform.of(starts, 16)
    walk = (rng.standard_normal((rows, count)) @ np.linalg.cholesky(truth.walk).T).cumsum(axis=0)
    readings = walk + rng.standard_normal((rows, count)) * np.sqrt(np.diag(truth.white))
    spectrum = transform.spectrum(readings)
    moments = Moments.of(spectrum, transform)
    noise = first_noise(transform.steps(readings), np.eye(count))
    shape = noise.walk
    heights = [noise.log_likelihood(spectrum, transform)]
    for _ in range(30):
        noise = improve(noise, moments, shape, 1, counts=1.0)
        heights.append(noise.log_likelihood(spectrum, transform))
    assert np.all(np.diff(heights) > -0.5)  # the prior of one step may cost that
    assert heights[-1] > truth.log_likelihood(spectrum, transform) - 8.0  # it began 1,000 below
    assert np.linalg.norm(noise.walk - truth.walk) < 0.3 * np.linalg.norm(truth.walk)


def test_no_body_of_a_healthy_ground_moves_like_all_others_together() -> None:
    rng = np.random.default_rng(12)
    count, rows = 20, 1001
    bodies = rng.standard_normal((count, 200))
    bodies /= np.linalg.norm(bodies, axis=0)
    starts = np.zeros(rows, dtype=np.bool_)
    starts[0] = True
    transform = StepTransform.of(starts, 16)
    moved = 0.03 * rng.standard_normal((rows, 200)).cumsum(axis=0)
    moved[:, 7] = rng.standard_normal(rows).cumsum()  # all others together move as much
    readings = moved @ bodies.T + 0.3 * rng.standard_normal((rows, count))
    shapes = Shapes((np.eye(count),), bodies)
    moments = Moments.of(transform.spectrum(readings), transform)
    noise = first_noise(transform.steps(readings), np.eye(count))
    _, weights = fit_shapes(noise, moments, shapes, np.zeros((count, count)))
    share = weights * shapes.seen(np.eye(count))
    assert share[8] == max(share[1:])
    assert share[8] <= 1.1 * LARGEST / len(shapes) * share.sum()
    assert share[8] > 0.9 * LARGEST / len(shapes) * share.sum()


def test_sizes_are_exact_though_the_factor_is_that_of_another_information() -> None:
    """Against dense algebra, information by band being wrong by up to three times."""
    rng = np.random.default_rng(9)
    root = rng.standard_normal((40, 30)) * np.geomspace(1.0, 1e3, 30)
    exact = root.T @ root
    wrong = np.sqrt(rng.uniform(1.0 / 3.0, 3.0, 30))
    by_band = wrong[:, None] * exact * wrong
    variance = rng.uniform(0.1, 2.0, 30)
    variance[[3, 17]] = 0.0
    pull = exact @ rng.standard_normal(30)
    used = variance > 0.0
    wanted = np.zeros(30)
    inner = exact[np.ix_(used, used)] + np.diag(1.0 / variance[used])
    wanted[used] = np.linalg.solve(inner, pull[used])
    its = NormalPriors.of(by_band, variance)
    found = its.exact_mean(pull, lambda sizes: exact @ sizes, 1e-6, 60)
    assert (found - wanted)[used] @ inner @ (found - wanted)[used] < 1e-4
    assert not np.any(found[~used])
    assert its.mean(pull) != pytest.approx(wanted, rel=0.1)


@pytest.mark.parametrize("rows", [300, 3000, 20000])
@pytest.mark.parametrize("ratio", [1e-9, 1e-4])
def test_information_by_band_is_right_for_what_is_slow(rows: int, ratio: float) -> None:
    """A ramp is at the slowest frequency, which noise alone leaves quieter than all others."""
    starts = np.zeros(rows, dtype=np.bool_)
    starts[0] = True
    transform = StepTransform.of(starts, 16)
    noise = StepNoise(np.array([[ratio]]), np.array([[1.0]]))
    for course in (np.arange(rows), np.arange(rows) > rows // 2, np.arange(rows) ** 2 / rows):
        power = transform.spectrum(course[:, None].astype(float)) ** 2
        exact = float(np.sum(power / noise.variance(transform)))
        by_band = float(np.sum(transform.by_band(power) * noise.inverse_variance(transform)))
        assert by_band == pytest.approx(exact, rel=0.35)
        some, share = transform.sample(12)
        sampled = float(share @ (power / noise.variance(transform))[some, 0])
        assert sampled == pytest.approx(exact, rel=0.35)


def test_weight_of_a_step_at_every_row() -> None:
    starts = np.zeros(60, dtype=bool)
    starts[[0, 7, 9, 40]] = True
    transform = StepTransform.of(starts, exact=True)
    weights = np.random.default_rng(0).random(len(transform))
    whole = transform.turn(np.eye(len(transform)))
    np.testing.assert_allclose(
        transform.at_rows(weights), np.diag(whole @ np.diag(weights) @ whole), rtol=1e-12
    )


def fitted_colour(steps: Matrix, white: float) -> tuple[StepNoise, Moments]:
    """The floor of readings of a ground with such steps, its colour fitted."""
    rows, count = steps.shape
    readings = steps.cumsum(axis=0) + white * np.random.default_rng(2).standard_normal(steps.shape)
    transform = StepTransform.of(np.arange(rows) == 0, 16)
    moments = Moments.of(transform.spectrum(readings), transform)
    level = float(np.mean(steps**2))
    noise = StepNoise(level * np.eye(count), white**2 * np.eye(count))
    level, noise = noise.recoloured(transform.spectrum(readings), transform)
    return replace(noise, walk=level[0] * noise.walk), moments


@pytest.mark.parametrize("power", [0.0, 1.0, 1.5])
def test_a_ground_of_another_power_of_the_frequency_is_fitted(power: float) -> None:
    """Motion of spectrum f^(−2−c): its steps have f^(−c), a factor 2^c from octave to octave."""
    rng = np.random.default_rng(1)
    rows = 4000
    frequency = np.fft.rfftfreq(8 * rows)
    frequency[0] = frequency[1]
    drawn = np.fft.rfft(rng.standard_normal((8 * rows, 6)), axis=0)
    level = (2.0 - 2.0 * np.cos(2.0 * np.pi * frequency)) ** (-0.25 * power)
    level[0] = 0.0
    steps = np.fft.irfft(drawn * level[:, None], axis=0)[:rows]
    found, moments = fitted_colour(steps, 0.01)
    np.testing.assert_allclose(np.mean(found.colour[0, 2:6]), power * np.log(2.0), atol=0.15)
    walking = replace(found, colour=0.0 * found.colour)
    assert (moments.more(found, walking) > 100.0) == (power > 0.0)


def test_a_ground_that_springs_back_is_fitted() -> None:
    """x_n = k x_(n−1) + e_n: its steps have λ/((1 − k)² + k λ), four per octave at slow ones."""
    kept = np.exp(-1.0 / 40.0)
    drawn = np.random.default_rng(5).standard_normal((8000, 12))
    steps = np.diff(lfilter([1.0], [1.0, -kept], drawn, axis=0), axis=0)
    found, _ = fitted_colour(steps, 0.05)
    assert found.colour[0, 8:11].mean() < -0.7
    assert np.abs(found.colour[0, :4]).max() < 0.1


@pytest.mark.parametrize("kept", [0.5, 0.2, 0.0])
def test_a_ground_that_goes_on_as_before_is_fitted(kept: float) -> None:
    """Steps Δ_n = φ Δ_(n−1) + e_n have variance (1 − φ²)/((1 − φ)² + φ λ) at λ."""
    rng = np.random.default_rng(3)
    steps = lfilter([np.sqrt(1.0 - kept**2)], [1.0, -kept], rng.standard_normal((6000, 12)), axis=0)
    found, _ = fitted_colour(steps, 0.05)
    at = np.geomspace(1e-4, 3.5, 30)
    usual = (1.0 - kept**2) / ((1.0 - kept) ** 2 + kept * at)
    walk = found.reddened(at)[:, 0] * np.trace(found.walk) / len(found.walk)
    np.testing.assert_allclose(np.log(walk / usual), 0.0, atol=0.2)


def test_each_plane_has_a_colour_of_its_own() -> None:
    """The ground of one goes on, that of the other walks, in readings that are mixed by row."""
    rng, kept = np.random.default_rng(6), 0.5
    drawn = rng.standard_normal((6000, 12))
    drawn[:, ::2] = lfilter([np.sqrt(1.0 - kept**2)], [1.0, -kept], drawn[:, ::2], axis=0)
    transform = StepTransform.of(np.arange(6001) == 0, 16)
    noise = StepNoise(np.eye(12), 0.0025 * np.eye(12), None, np.zeros((2, OCTAVES)),
                      np.arange(12) % 2)  # fmt: skip
    _, found = noise.recoloured(transform.turn(drawn), transform)
    assert found.colour[0, :2].min() > 0.4
    assert np.abs(found.colour[1, :3]).max() < 0.15


def test_the_colour_changes_no_mean_level() -> None:
    """The walk keeps its level: ln r is zero on average over the frequencies."""
    changes = np.random.default_rng(4).standard_normal(OCTAVES)
    angle = np.pi * (np.arange(400_000) + 0.5) / 400_000
    noise = StepNoise(np.eye(1), np.eye(1), colour=changes[None])
    mean = np.mean(np.log(noise.reddened(2.0 - 2.0 * np.cos(angle))[:, 0]))
    assert abs(float(mean)) < 1e-3
    usual = norm(scale=PER_OCTAVE)
    less = np.sum(usual.logpdf(0.0) - usual.logpdf(changes))
    assert rarity(changes) == pytest.approx(float(less))


def test_motion_that_is_new_at_every_row_is_told_from_the_noise() -> None:
    rng = np.random.default_rng(2)
    rows, count = 3000, 8
    patterns = rng.standard_normal((count, 5))
    patterns /= np.linalg.norm(patterns, axis=0)
    orbit = 0.2 * rng.standard_normal((rows, count)).cumsum(axis=0) * 0.1
    shaking = 2.0 * rng.standard_normal((rows, 1)) * patterns[:, 1]
    readings = orbit + shaking + 0.5 * rng.standard_normal((rows, count))
    starts = np.zeros(rows, dtype=bool)
    starts[0] = True
    transform = StepTransform.of(starts, 16)
    moments = Moments.of(transform.spectrum(readings), transform)
    noise = StepNoise(4e-4 * np.eye(count), np.eye(count))
    found, weights = fit_shaken(noise, moments, Shapes((np.eye(count),), patterns), rounds=60)
    np.testing.assert_allclose(weights[2], 4.0, rtol=0.15)
    assert weights[[1, 3, 4, 5]].max() < 0.2
    assert found.shaken is not None
    np.testing.assert_allclose(np.diag(found.white), found.reading + np.diag(found.shaken))
