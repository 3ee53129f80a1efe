"""The adaptive controllers: what they reach in short runs, and that every part can be left out."""

import json
from dataclasses import replace

import numpy as np
import pytest

from orbitfb.evaluate.paper.ablation import SENSITIVITIES, VARIANTS, ablation
from orbitfb.evaluate.paper.adaptive import (
    AdaptiveSettings,
    Loop,
    adaptive_linear,
    knowledge,
    memoryless,
    model_based_rl,
)
from orbitfb.evaluate.paper.environment import Environment, simulate
from orbitfb.evaluate.paper.metrics import figures, lqg_floor, summarise
from orbitfb.evaluate.paper.scenarios import make_scenario


@pytest.mark.parametrize(
    "make",
    [
        pytest.param(adaptive_linear, marks=pytest.mark.nightly),
        pytest.param(model_based_rl, marks=pytest.mark.nightly),
        pytest.param(memoryless, marks=pytest.mark.nightly),
    ],
)
def test_captures_in_two_steps_from_a_response_that_is_not_invertible(make) -> None:
    scenario = make_scenario("E2", steps=10_000, after=0)
    short = simulate(_cut(scenario, 200), range(2), make)
    assert np.all(short.observed[:, 2:-1] < 0.05e-3)
    assert np.all(short.observed[:, 1:-1] < 250e-6)
    assert np.mean(short.true[:, -50:-1]) < 0.2e-6


@pytest.mark.nightly
def test_the_network_is_the_linear_law_far_from_the_floor_and_at_it() -> None:
    scenario = _cut(make_scenario("E2", steps=10_000, after=0), 150)
    linear = simulate(scenario, range(1), adaptive_linear)
    network = simulate(scenario, range(1), model_based_rl)
    np.testing.assert_allclose(network.true[0, :3], linear.true[0, :3], rtol=0.02)
    late = slice(-50, -1)
    assert np.mean(network.true[0, late]) == pytest.approx(np.mean(linear.true[0, late]), rel=0.2)


def test_the_hidden_layers_stay_as_they_are() -> None:
    scenario = make_scenario("E2", steps=10_000, after=0)
    loop = Loop(scenario, 0, AdaptiveSettings())
    environment = Environment(scenario, [0])
    before = loop._network
    assert before is not None
    for _ in range(5):
        environment.step(loop.act(environment.observe()[0])[None])
    after = loop._network
    assert after is not None and loop.gain.swaps > 0
    for old, new in zip(before.weights[:-1], after.weights[:-1], strict=True):
        assert old is new
    assert not np.array_equal(before.weights[-1], after.weights[-1])


def test_comes_near_the_floor_of_lqg() -> None:
    """Without drift a mode is at its floor as soon as the first orbit is forgotten."""
    scenario = _cut(make_scenario("s1", steps=10_000, after=0), 400)
    curves = simulate(scenario, range(2), model_based_rl)
    true = np.sqrt(np.mean(curves.true[:, 200:-1] ** 2))
    assert true < 1.1 * lqg_floor(scenario)


def test_is_told_what_a_physicist_knows() -> None:
    still, moving = make_scenario("E2"), make_scenario("s3")
    told = knowledge(still, AdaptiveSettings())
    assert told.ground == 0.0 and told.creep == 0.0
    assert told.prior_entry == still.error_entry
    told = knowledge(moving, AdaptiveSettings())
    assert told.ground == pytest.approx(0.1e-6) and told.creep > 0.0
    doubled = knowledge(moving, AdaptiveSettings(drift_factor=2.0))
    assert doubled.drift_entry == pytest.approx(2.0 * told.drift_entry)


@pytest.mark.nightly
def test_every_variant_runs_and_can_be_written_as_json() -> None:
    rows = ablation(["E2"], trajectories=1, steps=30, after=5, variants=VARIANTS)
    assert [row["variant"] for row in rows] == list(VARIANTS)
    json.dumps(rows)
    assert all(row["swaps_per_tick"] > 0.0 or row["diverged"] for row in rows)
    for _, options in SENSITIVITIES.values():
        AdaptiveSettings.model_validate(options)


def test_figures_name_the_ratio_to_the_floor() -> None:
    scenario = make_scenario("s1", steps=100, after=10)
    curves = simulate(scenario, range(1), adaptive_linear)
    assert "true_over_lqg_floor" in figures(summarise(curves, 100), scenario)


def _cut(scenario, ticks: int):
    """Give the beginning of a scenario: the drift goes on as fast as in the whole one."""
    return replace(
        scenario,
        end=scenario.response(ticks),
        steps=ticks,
        drift_entry=scenario.drift_entry * np.sqrt(ticks / scenario.steps),
        drift_relative=scenario.drift_relative * np.sqrt(ticks / scenario.steps),
    )
