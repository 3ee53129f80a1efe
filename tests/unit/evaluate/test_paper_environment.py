"""The environment of the paper's experiment against closed forms."""

import numpy as np
import pytest
from paper_scenarios import still

from orbitfb.core.errors import ConfigError
from orbitfb.core.signals import Vector
from orbitfb.evaluate.paper.bias import naive_bias
from orbitfb.evaluate.paper.bound import TrueResponse
from orbitfb.evaluate.paper.environment import Environment, simulate
from orbitfb.evaluate.paper.laws import Shared, modal, svd
from orbitfb.evaluate.paper.metrics import lqg_floor
from orbitfb.evaluate.paper.scenarios import NAMES, NOISE, make_scenario


class Gain:
    """The same gain of all modes, by the exact inverse."""

    def __init__(self, response: Vector, gain: float) -> None:
        self._law = gain * np.linalg.inv(response)

    def changes(self, errors: Vector) -> Vector:
        return -errors @ self._law.T


def late_rms(curves: Vector) -> float:
    return float(np.sqrt(np.mean(curves[:, 100:-1] ** 2)))  # the last tick shows the re-kick


@pytest.mark.parametrize("gain", [1.0, 0.3])
def test_a_static_gain_leaves_the_noise_that_theory_says(gain: float) -> None:
    scenario = still(steps=600)
    curves = simulate(scenario, range(4), lambda _: Shared(Gain(scenario.start, gain)))
    sigma = scenario.reading_noise
    true = sigma * np.sqrt(gain / (2.0 - gain))
    assert late_rms(curves.true) == pytest.approx(true, rel=0.02)
    assert late_rms(curves.observed) == pytest.approx(np.hypot(sigma, true), rel=0.02)


def test_a_trajectory_does_not_depend_on_how_a_batch_is_cut() -> None:
    scenario = make_scenario("s3", steps=60, after=20)
    together = simulate(scenario, range(3), modal)
    alone = simulate(scenario, [2], modal)
    np.testing.assert_allclose(alone.true[0], together.true[2], rtol=1e-6)
    np.testing.assert_allclose(alone.observed[0], together.observed[2], rtol=1e-6)
    assert np.all(together.true[0, 1:] != together.true[1, 1:])


def test_orbits_begin_at_a_quarter_of_a_millimetre_and_are_kicked_by_as_much() -> None:
    environment = Environment(still(), range(3))
    np.testing.assert_allclose(np.sqrt(np.mean(environment.true**2, axis=1)), 250e-6)
    before = environment.true
    environment.kick()
    np.testing.assert_allclose(np.sqrt(np.mean((environment.true - before) ** 2, axis=1)), 250e-6)


def test_setpoints_that_stay_move_the_orbit_when_the_response_drifts() -> None:
    scenario = make_scenario("s2", steps=100, after=0)
    environment = Environment(scenario, [0])
    calm = Environment(scenario, [0])
    change = np.full((1, scenario.start.shape[1]), 1e-6)
    for tick in range(10):
        environment.observe(), calm.observe()
        environment.step(change if tick == 0 else 0.0 * change)
        calm.step(0.0 * change)
    expected = change @ scenario.response(10).T
    np.testing.assert_allclose(environment.true - calm.true, expected, rtol=1e-9, atol=1e-15)


def test_the_first_orbit_decays_mode_by_mode_under_the_papers_law() -> None:
    scenario = still(reading_noise=0.0, error_entry=0.0)
    environment = Environment(scenario, range(2))
    first = environment.true
    controller = svd(environment, regularisation=25.0, gain=0.5)
    for tick in range(30):
        environment.step(controller.act(environment.observe(), tick))
    u, sigma, _ = np.linalg.svd(scenario.start)
    shrunk = (1.0 - 0.5 * sigma**2 / (sigma**2 + 25.0)) ** 30
    np.testing.assert_allclose(environment.true @ u, (first @ u) * shrunk, rtol=1e-6, atol=1e-16)


def test_a_lost_trajectory_stays_at_five_millimetres_and_alone() -> None:
    class Wrong:
        def act(self, observed: Vector, tick: int) -> Vector:
            changes = -observed @ inverse.T
            changes[0] *= -1.0
            return changes

    scenario = still(steps=60)
    inverse = np.linalg.inv(scenario.start)
    curves = simulate(scenario, range(2), lambda _: Wrong())
    assert curves.lost.tolist() == [True, False]
    assert np.all(curves.true[0, 10:-1] == 5e-3)
    assert np.all(curves.true[1, 10:-1] < 1e-6)


def test_who_knows_the_response_reaches_the_floor_of_theory() -> None:
    scenario = make_scenario("s2", steps=300, after=0)
    curves = simulate(scenario, range(4), TrueResponse)
    assert late_rms(curves.true) / lqg_floor(scenario) == pytest.approx(1.0, abs=0.03)


def test_pairs_are_as_the_scenarios_say() -> None:
    scenarios = {name: make_scenario(name) for name in NAMES}
    optics = scenarios["E2-clean"].start
    smallest = np.linalg.svd(optics, compute_uv=False)[-1]
    paper = scenarios["E1"]
    errors = paper.start - optics
    assert np.std(errors) == pytest.approx(NOISE * smallest, rel=0.02)
    for name in ("E2", "E2h"):
        np.testing.assert_array_equal(scenarios[name].start, paper.start)
        np.testing.assert_array_equal(scenarios[name].end, paper.end)
    np.testing.assert_array_equal(paper.known(3), paper.start)
    doubt = scenarios["E2"].known(3) - paper.start
    assert np.linalg.norm(doubt, 2) == pytest.approx(0.8 * smallest)
    assert scenarios["E2"].error_entry == pytest.approx(np.std(doubt), rel=0.06)
    assert np.std(scenarios["E2h"].known(3) - paper.start) == pytest.approx(0.02, rel=0.02)


def test_near_null_modes_change_their_sign_on_the_way() -> None:
    scenario = make_scenario("E1")
    shares = np.linspace(0, scenario.steps, 101)
    signs = [np.linalg.slogdet(scenario.response(int(share)))[0] for share in shares]
    assert {-1.0, 1.0} <= set(signs)


@pytest.mark.nightly
@pytest.mark.parametrize("gain", [1.0, 0.3])
def test_the_naive_refit_confirms_the_running_law(gain: float) -> None:
    answer = naive_bias(gain, "x", 7, 2500)
    assert answer["expected"] == 1.0 + gain / 2.0
    assert answer["found"] == pytest.approx(answer["expected"], rel=0.1)


def test_unknown_scenarios_and_lengths_are_refused() -> None:
    with pytest.raises(ConfigError, match="no scenario 'E4': choose from E1, E2"):
        make_scenario("E4")
    with pytest.raises(ConfigError, match="drift of 0 steps"):
        make_scenario("E1", steps=0)
