"""Campaigns of the refit evaluation: the points, the table, the files."""

import json

import pytest
from pydantic import ValidationError

from orbitfb.evaluate import grid
from orbitfb.evaluate.grid import GridRow, GridSettings, Spread, evaluate_grid, one_point
from orbitfb.evaluate.grid_report import table, write
from orbitfb.evaluate.refit import RefitEvaluationSettings, evaluate_refit

SETTINGS = GridSettings(seeds=(1, 2, 4), drifts=("mild", "strong"), horizons=(600, 700))


def figures(seed, told=1e-7):
    ratios = {"rms_ratio_frozen": 2.0 * seed, "rms_ratio_naive": 3.0, "rms_ratio_ours": 1.1}
    return {"rms_told": told, **ratios, "promoted": float(seed)}


ROWS = [
    GridRow("mild", 0.2e-6, 600, {1: figures(1), 2: figures(2), 4: figures(4)}),
    GridRow("strong", 1e-6, 700, {1: {**figures(1), "gain_naive": 2.0}, 2: figures(1)}),
]


def test_points_are_all_combinations():
    points = SETTINGS.points()
    assert len(points) == len({point.model_dump_json() for point in points}) == 12
    assert [point.seed for point in points[:4]] == [1, 2, 4, 1]
    assert {(point.drift, point.ticks) for point in points} == {
        ("mild", 600), ("mild", 700), ("strong", 600), ("strong", 700),
    }  # fmt: skip


def test_a_point_that_cannot_be_run_is_refused_before_anything_runs():
    with pytest.raises(ValidationError):
        GridSettings(horizons=(10,)).points()
    with pytest.raises(ValidationError):
        GridSettings(seeds=())


def test_spread_is_over_the_seeds_and_only_of_figures_that_all_have():
    assert ROWS[0].spreads()["rms_ratio_frozen"] == Spread(4.0, 2.0, 8.0)
    assert "gain_naive" not in ROWS[1].spreads()


def test_results_are_sorted_by_point(monkeypatch, tmp_path):
    def fake(tasks, *rest):
        assert rest[:3] == (tmp_path, 2, "tcp://x")
        chosen = [task.arguments["settings"] for task in tasks]
        return [{"figures": {"ticks": s["ticks"], "seed": s["seed"]}} for s in chosen]

    monkeypatch.setattr(grid, "run_tasks", fake)
    rows = evaluate_grid(SETTINGS, tmp_path, 2, "tcp://x")
    assert [(row.drift, row.ticks) for row in rows] == [
        ("mild", 600), ("mild", 700), ("strong", 600), ("strong", 700),
    ]  # fmt: skip
    for row in rows:
        assert all(
            figure == {"ticks": row.ticks, "seed": seed} for seed, figure in row.figures.items()
        )


@pytest.mark.nightly
def test_a_point_is_the_evaluation_of_refits():
    settings = RefitEvaluationSettings(ticks=600, seed=3, bpm_noise=0.4e-6)
    result, expected = one_point(settings.model_dump(mode="json")), evaluate_refit(settings)
    assert result["figures"]["rms_ours"] == expected.figures["rms_ours"]
    assert result["true_rms_ours"].shape == (600,)
    quiet = evaluate_refit(settings.model_copy(update={"bpm_noise": 0.2e-6}))
    assert expected.figures["rms_told"] > 1.5 * quiet.figures["rms_told"]


def test_table_shows_median_and_spread():
    lines = table(SETTINGS, ROWS).splitlines()
    assert "| mild | 0.2 | 600 | 0.1 | 4 (2 to 8) | 3 | 1.1 | 2 (1 to 4) |" in lines
    assert "| strong | 1 | 700 | 0.1 | 2 | 3 | 1.1 | 1 |" in lines


def test_files_hold_figures_and_settings(tmp_path):
    write(SETTINGS, ROWS, tmp_path / "new")
    document = json.loads((tmp_path / "new" / "campaign.json").read_text())
    assert document["settings"]["seeds"] == [1, 2, 4]
    row = document["rows"][0]
    assert row["figures"]["rms_ratio_frozen"] == {"median": 4.0, "low": 2.0, "high": 8.0}
    assert row["seeds"]["4"]["rms_ratio_frozen"] == 8.0
    assert "# Campaign" in (tmp_path / "new" / "campaign.md").read_text()
    assert (tmp_path / "new" / "campaign.png").read_bytes().startswith(b"\x89PNG")
