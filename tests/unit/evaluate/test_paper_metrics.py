"""Figures of the paper's experiment on curves made by hand; the table they go into."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paper_scenarios import still

from orbitfb.core.errors import ConfigError
from orbitfb.evaluate.paper.environment import Curves
from orbitfb.evaluate.paper.methods import METHODS, find_method
from orbitfb.evaluate.paper.metrics import combine, figures, lqg_floor, summarise
from orbitfb.evaluate.paper.run import PaperResult, evaluate_paper
from orbitfb.evaluate.paper.scenarios import make_scenario
from orbitfb.evaluate.paper.settings import PaperSettings
from orbitfb.evaluate.paper.table import markdown
from orbitfb.evaluate.paper.targets import TARGETS, judge
from orbitfb.evaluate.paper.write import prepare, write

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


def test_the_lqg_floor_of_equal_modes_is_that_of_one() -> None:
    scenario = still(white=0.1e-6)
    ratio = (0.1 / 0.2) ** 2
    variance = 0.2e-6**2 * 0.5 * (ratio + np.sqrt(ratio**2 + 4.0 * ratio))
    assert lqg_floor(scenario) == pytest.approx(np.sqrt(variance), rel=1e-6)
    assert lqg_floor(still()) == 0.0


@pytest.fixture(scope="module")
def result() -> PaperResult:
    settings = PaperSettings(
        scenarios=("E2", "E1"),
        methods=("svd", "true-response", "modal"),
        trajectories=2,
        static_trajectories=3,
        steps=300,
        after=5,
    )
    return evaluate_paper(settings, workers=1)


def test_the_table_holds_what_is_promised(result: PaperResult, tmp_path: Path) -> None:
    write(result, tmp_path)
    table = json.loads((tmp_path / "table.json").read_text())
    assert list(table["scenarios"]) == ["E1", "E2"]
    assert table["methods"] == table["scenarios"]["E2"]["methods"]
    needed = {
        "min_rms_mm",
        "max_rms_mm",
        "final_rms_mm",
        "final_true_rms_mm",
        "steps_to_0p05",
        "steps_to_0p05_worst",
        "diverged",
        "rekick",
    }
    for method in table["methods"].values():
        assert needed <= method.keys()
    assert table["methods"]["svd"]["trajectories"] == 3
    assert table["methods"]["true-response"]["trajectories"] == 2
    assert table["settings"]["seed"] == 7
    assert len(table["naive_bias"]) == 2
    told = {(target["scenario"], target["method"]) for target in table["targets"]}
    assert {("E1", "svd"), ("naive refit", "gain 1")} <= told
    assert not any(method == "model-based-rl" for _, method in told)
    page = (tmp_path / "index.html").read_text()
    assert "the paper: SVD" in page and page.count("data:image/png;base64") == 6
    assert "://" not in page
    text = (tmp_path / "table.md").read_text()
    assert text == markdown(table) and "*the paper*" in text
    assert (tmp_path / "E2-long.png").is_file()


def test_who_knows_the_response_is_best(result: PaperResult) -> None:
    for methods in result.methods.values():
        ends = {name: one.figures["final_true_rms_mm"] for name, one in methods.items()}
        assert min(ends, key=lambda name: ends[name]) == "true-response"


def test_parts_that_are_there_are_not_run_again(tmp_path: Path) -> None:
    settings = PaperSettings(
        scenarios=("E1",), methods=("svd",), static_trajectories=17, steps=100, after=0
    )
    told: list[int] = []
    first = evaluate_paper(settings, tmp_path, 1, progress=lambda _w, done, _t: told.append(done))
    assert told == [0, 1, 2, 3, 4]
    told.clear()
    again = evaluate_paper(settings, tmp_path, 1, progress=lambda _w, done, _t: told.append(done))
    assert told == [4]
    assert first.methods["E1"]["svd"].figures == again.methods["E1"]["svd"].figures
    assert first.methods["E1"]["svd"].figures["trajectories"] == 17


def test_the_best_in_hindsight_is_no_worse_than_the_papers_law() -> None:
    settings = PaperSettings(
        scenarios=("E1",), methods=("svd", "svd-best"), static_trajectories=2, steps=100, after=0
    )
    methods = evaluate_paper(settings, workers=1).methods["E1"]
    svd, best = methods["svd"].figures, methods["svd-best"].figures
    assert best["final_true_rms_mm"] <= svd["final_true_rms_mm"]
    assert set(best["options"]) == {"regularisation", "gain"}


def test_targets_are_about_methods_and_are_judged_by_their_bounds() -> None:
    names = {target.method for target in TARGETS if target.scenario != "naive refit"}
    assert names <= {*METHODS, "model-based-rl", "model-based-rl-memoryless"}
    row: Mapping[str, Any] = {
        "min_rms_mm": 0.0211,
        "max_rms_mm": 0.25,
        "final_rms_mm": 0.031,
        "steps_to_0p05": None,
    }
    verdicts = {one.target.figure: one.reached for one in judge({"E1": {"svd": row}})}
    assert verdicts == {
        "min_rms_mm": True,
        "max_rms_mm": True,
        "final_rms_mm": False,
        "steps_to_0p05": False,
    }
    never = judge({"E1": {"supervised": {**row, "steps_to_0p05": 10}}})
    assert not next(one for one in never if one.target.figure == "steps_to_0p05").reached


def test_wrong_wishes_are_refused_with_the_choices(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="E9 is unknown; choose from E1, E2"):
        PaperSettings(scenarios=("E9",))
    with pytest.raises(ValueError, match="magic is unknown; choose from svd"):
        PaperSettings(methods=("svd", "magic"))
    with pytest.raises(ConfigError, match="no method 'magic'"):
        find_method("magic")
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="--out"):
        prepare(tmp_path / "file" / "deeper")


def test_titles_of_all_scenarios() -> None:
    from orbitfb.evaluate.paper.table import TITLES

    assert all(make_scenario(name, steps=1).name == name for name in TITLES)
