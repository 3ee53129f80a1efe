"""Figures of the paper's experiment on curves made by hand."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from paper_scenarios import still

from orbitfb.evaluate.paper.environment import Curves
from orbitfb.evaluate.paper.metrics import combine, figures, lqg_floor, summarise

STEPS, AFTER = 200, 9


def made() -> Curves:
    """Two trajectories: down in 3 and in 5 steps, up again after the re-kick."""
    true = np.full((2, STEPS + AFTER + 1), 1e-6)
    true[0, :3], true[1, :5] = 250e-6, 400e-6
    true[0, STEPS : STEPS + 4] = [250e-6, 300e-6, 40e-6, 1e-6]
    true[0, STEPS + 4 :] = 0.4e-6
    true[1, STEPS:] = 250e-6
    return Curves(observed=true + 1e-6, true=true, lost=np.array([False, False]))


def found(curves: Curves) -> dict[str, Any]:
    scenario = replace(still(STEPS), after=AFTER)
    return figures(combine([summarise(curves, STEPS).arrays()]), scenario)


def test_figures_of_curves_made_by_hand() -> None:
    answer = found(made())
    assert answer["trajectories"] == 2
    assert answer["min_rms_mm"] == pytest.approx(0.002)
    assert answer["max_rms_mm"] == pytest.approx(0.326)
    assert answer["final_rms_mm"] == pytest.approx(0.002)
    assert answer["final_true_rms_mm"] == pytest.approx(0.001)
    assert (answer["steps_to_0p05"], answer["steps_to_0p05_worst"]) == (5, 5)
    assert answer["diverged"] == 0
    rekick = answer["rekick"]
    assert (rekick["steps_to_0p05_median"], rekick["steps_to_0p05_worst"]) == (None, None)
    assert rekick["max_over_kick"] == pytest.approx(1.2)
    assert "true_over_lqg_floor" not in answer


def test_median_and_worst_of_the_rekick() -> None:
    curves = made()
    curves.true[1, STEPS:] = curves.true[0, STEPS:]
    rekick = found(curves)["rekick"]
    assert (rekick["steps_to_0p05_median"], rekick["steps_to_0p05_worst"]) == (2, 2)
    assert (rekick["steps_to_0p5um_median"], rekick["steps_to_0p5um_worst"]) == (4, 4)


def test_a_trajectory_that_ends_above_its_start_has_diverged() -> None:
    curves = made()
    curves.true[0, 50:STEPS] = 251e-6
    assert found(curves)["diverged"] == 1
    lost = replace(made(), lost=np.array([False, True]))
    assert found(lost)["diverged"] == 1


def test_pieces_put_together_are_the_whole() -> None:
    curves = made()
    pieces = [
        Curves(curves.observed[part], curves.true[part], curves.lost[part])
        for part in (slice(0, 1), slice(1, 2))
    ]
    together = combine([summarise(piece, STEPS).arrays() for piece in pieces])
    whole = summarise(curves, STEPS)
    for name, value in whole.arrays().items():
        np.testing.assert_array_equal(together.arrays()[name], value)


def test_the_floor_is_compared_with_the_rms_over_trajectories() -> None:
    scenario = replace(still(STEPS, white=0.1e-6), after=AFTER)
    true = np.full((2, STEPS + AFTER + 1), 3e-6)
    true[1] = 4e-6
    curves = Curves(observed=true, true=true, lost=np.array([False, False]))
    answer = figures(summarise(curves, STEPS), scenario)
    ratio = np.sqrt((9.0 + 16.0) / 2.0) * 1e-6 / lqg_floor(scenario)
    assert answer["true_over_lqg_floor"] == pytest.approx(ratio)
    assert answer["final_true_rms_mm"] == pytest.approx(0.0035)


def test_the_lqg_floor_of_equal_modes_is_that_of_one() -> None:
    scenario = still(white=0.1e-6)
    ratio = (0.1 / 0.2) ** 2
    variance = 0.2e-6**2 * 0.5 * (ratio + np.sqrt(ratio**2 + 4.0 * ratio))
    assert lqg_floor(scenario) == pytest.approx(np.sqrt(variance), rel=1e-6)
    assert lqg_floor(still()) == 0.0
