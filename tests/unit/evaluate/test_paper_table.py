"""What the paper's experiment leaves behind, and the command as people call it."""

import importlib.util
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from orbitfb.cli.app import app
from orbitfb.core.errors import ConfigError
from orbitfb.evaluate.paper.methods import METHODS, find_method
from orbitfb.evaluate.paper.report.pictures import COLOURS
from orbitfb.evaluate.paper.report.table import TITLES, markdown
from orbitfb.evaluate.paper.report.targets import TARGETS, judge
from orbitfb.evaluate.paper.report.write import prepare, write
from orbitfb.evaluate.paper.run import PaperResult, evaluate_paper
from orbitfb.evaluate.paper.scenarios import NAMES
from orbitfb.evaluate.paper.settings import PaperSettings


@pytest.fixture(scope="module")
def result() -> PaperResult:
    settings = PaperSettings(
        scenarios=("E2", "E1"),
        methods=("svd", "true-response"),
        trajectories=2,
        static_trajectories=3,
        steps=100,
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
        scenarios=("E1",), methods=("svd",), static_trajectories=9, steps=100, after=0
    )
    told: list[int] = []
    first = evaluate_paper(settings, tmp_path, 1, progress=lambda _w, done, _t: told.append(done))
    assert told == [0, 1, 2, 3, 4]
    told.clear()
    again = evaluate_paper(settings, tmp_path, 1, progress=lambda _w, done, _t: told.append(done))
    assert told == [4]
    assert first.methods["E1"]["svd"].figures == again.methods["E1"]["svd"].figures
    assert first.methods["E1"]["svd"].figures["trajectories"] == 9


@pytest.mark.nightly
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
    assert names <= METHODS.keys()
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


def test_all_scenarios_have_titles() -> None:
    assert set(TITLES) == set(NAMES)


def call(*words: str) -> Any:
    return CliRunner().invoke(app, ["evaluate", "paper", *words])


@pytest.mark.nightly
def test_the_command_writes_and_goes_on(tmp_path: Path) -> None:
    words = ["--scenario", "E1", "--method", "svd", "--trajectories", "2", "--steps", "100"]
    words += ["--workers", "1", "--out", str(tmp_path / "out")]
    first = call(*words)
    assert first.exit_code == 0, first.output
    assert "0 of 3 runs done" in first.output and "| svd | 2 |" in first.output
    table = (tmp_path / "out" / "table.json").read_text()
    second = call(*words)
    assert "3 of 3 runs done" in second.output and "0 of 3 runs" not in second.output
    assert (tmp_path / "out" / "table.json").read_text() == table


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--quick", "--full"], "--quick and --full exclude each other"),
        (["--scenario", "E9"], "--scenario: there is no 'E9'; choose from E1, E2"),
        (["--method", "magic"], "--method: there is no 'magic'; choose from svd"),
        (["--plane", "z"], "--plane: Input should be 'x' or 'y'"),
        (["--workers", "0"], "--workers is 0; at least one is needed"),
    ],
)
def test_wrong_options_are_refused(words: list[str], told: str, tmp_path: Path) -> None:
    answer = call("--out", str(tmp_path), *words)
    assert isinstance(answer.exception, ConfigError)
    assert told in str(answer.exception)


def test_a_method_without_its_extra_is_left_out_with_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda n: None if n == "stable_baselines3" else find(n)
    )
    monkeypatch.setattr("orbitfb.evaluate.paper.report.write._draw", lambda *_: {})
    words = ["--method", "svd", "--method", "ppo", "--trajectories", "1", "--steps", "100"]
    answer = call("--out", str(tmp_path), "--workers", "1", *words)
    assert answer.exit_code == 0, answer.output
    assert "ppo is left out: it needs the extra 'rl'" in answer.output
    assert list(json.loads((tmp_path / "table.json").read_text())["methods"]) == ["svd"]


def test_every_method_has_a_colour_of_its_own() -> None:
    assert set(COLOURS) == set(METHODS)
    assert len(set(COLOURS.values())) == len(METHODS)
