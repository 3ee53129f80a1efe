"""The identification: against an explicit posterior, and on the simulated ring in closed loop."""

import numpy as np
import pytest

from orbitfb.core.errors import EstimationError
from orbitfb.evaluate.simulate import ClosedLoop
from orbitfb.models.filter import ground_ratio
from orbitfb.models.identify import Identifier
from orbitfb.models.linear import excited_gain
from orbitfb.models.naive import naive_least_squares
from orbitfb.models.noise import LADDER
from orbitfb.models.rows import Rows, select_rows
from orbitfb.models.settings import IdentifySettings
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant
from orbitfb.policies.svd import SvdPolicy, SvdSettings

STILL = IdentifySettings(drift_entry=0.0, drift_relative=0.0)
NOISE = 0.2e-6


def rows_of(changes, differences, dither=None):
    count = len(changes)
    return Rows(
        tick=np.arange(count),
        change=changes,
        dither=np.zeros_like(changes) if dither is None else dither,
        difference=differences,
        valid=np.ones(differences.shape, dtype=bool),
        starts=np.arange(count) == 0,
        closed=np.ones(count, dtype=bool),
        left_out={},
    )


def open_loop(response, count, seed, ground=0.02e-6, size=2e-3):
    """Random changes that owe nothing to the readings."""
    generator = np.random.default_rng(seed)
    n, m = response.shape
    changes = size * generator.standard_normal((count, m))
    steps = changes @ response.T + ground * generator.standard_normal((count, n))
    noise = NOISE * generator.standard_normal((count + 1, n))
    return changes, steps + np.diff(noise, axis=0)


def small_response(n=6, m=5):
    return 1e-3 * np.random.default_rng(0).standard_normal((n, m))


def test_equals_the_posterior_of_generalised_least_squares():
    """One block without drift: the exact posterior under the covariance of the differences."""
    response = small_response()
    changes, differences = open_loop(response, 60, 1)
    settings = STILL.model_copy(
        update={"prior_entry": 1e-4, "prior_relative": 0.0, "creep_memory": 1e12}
    )
    start = response + 1e-4
    identifier = Identifier(start, settings)
    identifier.absorb(rows_of(changes, differences))
    model = identifier.model
    design = np.column_stack([changes, np.ones(60)])
    prior = np.diag([*np.full(5, settings.prior_entry**2), settings.creep**2])
    shift = np.eye(60, k=1) + np.eye(60, k=-1)
    for mode, level in enumerate(model.levels):
        reading = model.reading_variance
        noise = (2 + ground_ratio(LADDER[level])) * reading * np.eye(60) - reading * shift
        information = np.linalg.inv(prior) + design.T @ np.linalg.solve(noise, design)
        covariance = np.linalg.inv(information)
        before = np.append(model.modes[:, mode] @ start, 0.0)
        residual = differences @ model.modes[:, mode] - design @ before
        after = before + covariance @ design.T @ np.linalg.solve(noise, residual)
        sigma = np.sqrt(np.diag(covariance)[:-1])
        found = model.modes[:, mode] @ model.response
        assert np.all(np.abs(found - after[:-1]) < 0.05 * sigma)
        assert np.allclose(model.covariances[level], covariance[:-1, :-1], rtol=0.02, atol=1e-12)


@pytest.fixture(scope="module")
def quiet():
    """A closed loop on the still ring, begun with a response drawn from the prior."""
    plant = Plant(Ring.load(), seed=3)
    truth = plant.response
    first = Identifier(truth, STILL).model.sample(np.random.default_rng(7))
    loop = ClosedLoop(plant, SvdPolicy(first, SvdSettings()), 1500).run()
    return truth, first, loop


def test_closed_loop_estimate_is_unbiased_and_knows_how_sure_it_is(quiet):
    truth, first, loop = quiet
    identifier = Identifier(first, STILL)
    absorbed = identifier.absorb(select_rows(loop.transitions(), 1e-6))
    model = identifier.model
    assert excited_gain(model.response, truth, loop.applied(300)) == pytest.approx(1.0, abs=0.02)
    errors = model.normalised_errors(truth)
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(1.0, abs=0.1)
    assert np.mean(np.abs(errors) < 2.0) > 0.94
    assert absorbed.chi2 == pytest.approx(1.0, abs=0.1)
    assert np.sqrt(model.reading_variance) == pytest.approx(NOISE, rel=0.03)
    assert np.linalg.norm(model.response - truth) < np.linalg.norm(first - truth)


def test_naive_estimate_shows_its_bias(quiet):
    truth, _, loop = quiet
    estimate = naive_least_squares(select_rows(loop.transitions(300), 1e-6))
    gain = loop.policy.gain_matrix
    loop_gain = np.mean(np.diag(truth @ gain))
    assert np.mean(np.diag(estimate @ gain)) == pytest.approx(1 + loop_gain / 2, rel=0.05)
    assert excited_gain(estimate, truth, loop.applied(300)) > 2.0


@pytest.mark.parametrize("apart", [1.0, 1e-7, 0.0])
def test_naive_estimate_solves_least_squares(apart):
    """Also where two correctors moved alike, and the normal equations have lost the digits."""
    changes, differences = open_loop(small_response(), 200, 3)
    changes[:, 2] = changes[:, 1] + apart * changes[:, 2]
    estimate = naive_least_squares(rows_of(changes, differences))
    expected = np.linalg.pinv(changes) @ differences
    np.testing.assert_allclose(estimate.T, expected, rtol=1e-5, atol=1e-9)


def test_naive_needs_enough_rows(quiet):
    with pytest.raises(EstimationError, match="10 transitions"):
        naive_least_squares(select_rows(quiet[2].transitions(1489), 1e-6))


def test_many_short_calls_equal_one_long_one():
    response = small_response()
    changes, differences = open_loop(response, 200, 2)
    settings = STILL.model_copy(update={"block": 50})
    whole, parts = Identifier(response, settings), Identifier(response, settings)
    rows = rows_of(changes, differences)
    whole.absorb(rows)
    for begin in range(0, 200, 50):
        piece = rows.take(begin, begin + 50)
        piece.starts[0] = True  # as a snapshot shows it: nothing is known of the row before
        parts.absorb(piece)
    assert np.allclose(whole.model.response, parts.model.response)
    assert parts.last_tick == 199


def test_a_kick_moves_the_orbit_and_not_the_response():
    response = small_response()
    changes, differences = open_loop(response, 200, 3)
    kicked = differences.copy()
    kicked[120] += 100e-6
    calm, shaken = Identifier(response, STILL), Identifier(response, STILL)
    calm.absorb(rows_of(changes, differences))
    absorbed = shaken.absorb(rows_of(changes, kicked))
    assert (absorbed.kicks, absorbed.rows) == (1, 199)
    sigma = np.sqrt(np.trace(shaken.model.row_covariance) / 5)
    assert np.max(np.abs(calm.model.response - shaken.model.response)) < sigma


def test_surprise_everywhere_is_a_new_response_and_not_kicks():
    response = small_response()
    changes, differences = open_loop(1.5 * response, 400, 4)
    settings = STILL.model_copy(update={"prior_relative": 0.005, "prior_entry": 0.0})
    identifier = Identifier(response, settings)
    identifier.absorb(rows_of(changes, differences))
    assert excited_gain(identifier.model.response, 1.5 * response, changes) == pytest.approx(
        1.0, abs=0.05
    )


def test_uncertainty_grows_while_nothing_is_excited():
    response = small_response()
    identifier = Identifier(response, IdentifySettings())
    noise = NOISE * np.random.default_rng(5).standard_normal((301, 6))
    before = np.trace(identifier.model.row_covariance)
    identifier.absorb(rows_of(np.zeros((300, 5)), np.diff(noise, axis=0)))
    assert np.allclose(identifier.model.response, response)
    assert np.trace(identifier.model.row_covariance) > before
    assert np.sqrt(identifier.model.reading_variance) == pytest.approx(NOISE, rel=0.1)


def test_a_dead_bpm_teaches_nothing_and_spoils_nothing():
    response = small_response()
    changes, differences = open_loop(response, 300, 6)
    rows = rows_of(changes, differences)
    rows.valid[:, 2] = False
    rows.difference[:, 2] = 0.0
    identifier = Identifier(1.02 * response, STILL)
    identifier.absorb(rows)
    slopes = np.sum(identifier.model.response * response, axis=1) / np.sum(response**2, axis=1)
    assert slopes[2] == pytest.approx(1.02, abs=0.005)
    assert np.delete(slopes, 2) == pytest.approx(1.0, abs=0.005)


def test_dither_as_instrument_finds_what_the_estimate_lacks():
    response = small_response()
    changes, differences = open_loop(response, 800, 7, size=2e-4)
    sure = STILL.model_copy(update={"prior_entry": 1e-12, "prior_relative": 0.0})
    absorbed = Identifier(response / 1.2, sure).absorb(rows_of(changes, differences, changes))
    share = absorbed.dither_pull / absorbed.dither_information
    sigma = absorbed.dither_information**-0.5
    assert sigma < 0.05
    assert share == pytest.approx(0.2, abs=4 * sigma)


def test_creep_is_told_from_a_change_of_the_response():
    """A steady loop answers a creep with steady changes that together move nothing."""
    response = small_response(5, 5)
    creep = 20e-9 * np.ones(5)
    generator = np.random.default_rng(8)
    answer = -np.linalg.solve(response, creep)
    changes = answer + 1e-5 * generator.standard_normal((2000, 5))
    noise = NOISE * generator.standard_normal((2001, 5))
    differences = changes @ response.T + creep + np.diff(noise, axis=0)
    settings = STILL.model_copy(update={"creep": 20e-9, "prior_relative": 0.02})
    identifier = Identifier(response, settings)
    identifier.absorb(rows_of(changes, differences))
    assert identifier.model.modes @ identifier.model.creep == pytest.approx(creep, rel=0.1)


def test_refuses_what_cannot_be_a_prior():
    with pytest.raises(EstimationError, match="finite matrix"):
        Identifier(np.full((3, 3), np.nan), STILL)
    with pytest.raises(EstimationError, match="both 0"):
        Identifier(np.eye(3), IdentifySettings(prior_entry=0.0, prior_relative=0.0))


def test_a_ring_at_rest_is_not_taken_for_one_that_drifts_quickly():
    response = small_response()
    changes, differences = open_loop(response, 1500, 9, size=3e-4)
    identifier = Identifier(response, IdentifySettings())
    identifier.absorb(rows_of(changes, differences))
    assert identifier.drift == 0


def test_a_quick_drift_is_noticed_and_followed():
    response = small_response()
    count = 4000
    changes, differences = open_loop(response, count, 10, size=3e-4)
    end = response + 0.6 * small_response()[::-1]
    share = np.arange(count) / count
    differences += share[:, None] * (changes @ (end - response).T)
    identifier = Identifier(response, IdentifySettings())
    identifier.absorb(rows_of(changes, differences))
    assert identifier.drift > 0
    before = np.linalg.norm(response - end)
    assert np.linalg.norm(identifier.model.response - end) < 0.5 * before


def test_rows_speak_of_the_response_that_is_asked_about_now():
    """Another incumbent in the middle of a chunk: its rows are compared with it alone."""
    response = small_response()
    changes, differences = open_loop(response, 200, 11)
    rows = rows_of(changes, differences)
    settings = STILL.model_copy(update={"block": 511})
    switched, straight = Identifier(response, settings), Identifier(response, settings)
    switched.absorb(rows.take(0, 100), 1.5 * response)
    straight.absorb(rows.take(0, 100), 1.01 * response)
    one = switched.absorb(rows.take(100), 1.01 * response)
    other = straight.absorb(rows.take(100), 1.01 * response)
    assert one.nats == pytest.approx(other.nats, rel=1e-6)
    assert one.nats > 0.0


def test_rows_that_were_learnt_from_do_not_speak_again():
    """R̂ fits the loud rows of a kick better than the truth does; later rows are no proof of it."""
    response = small_response(40, 40)
    changes, differences = open_loop(response, 500, 12, size=3e-5)
    loud = 3e-3 * np.random.default_rng(13).standard_normal((20, 40))
    changes[:20] += loud
    differences[:20] += loud @ response.T
    rows = rows_of(changes, differences)
    identifier = Identifier(response, STILL)
    identifier.absorb(rows.take(0, 50), response)
    later = [identifier.absorb(rows.take(at, at + 50), response) for at in range(50, 500, 50)]
    assert sum(piece.rows * piece.nats for piece in later) < 5.0
