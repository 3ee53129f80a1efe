"""The evaluation of refits: its figures, its files, its reproducibility."""

import json

import numpy as np
import pytest

from orbitfb.evaluate.refit import RefitEvaluationSettings, evaluate_refit, write


@pytest.fixture(scope="module")
def begun():
    return []


@pytest.fixture(scope="module")
def still(begun):
    return evaluate_refit(RefitEvaluationSettings(ticks=800, seed=4), begun.append)


def test_it_says_what_begins(still, begun):
    assert begun == [f"{law}: 800 ticks" for law in ("frozen", "naive", "ours")]


def test_ours_does_no_harm_on_a_still_ring(still):
    assert still.figures["rms_ratio_ours"] <= 1.05
    assert still.figures["gain_ours"] == pytest.approx(1.0, abs=0.05)
    assert still.figures["within_two_sigma_ours"] > 0.95


def test_naive_shows_the_bias_that_is_expected(still):
    figures = still.figures
    assert figures["gain_naive"] == pytest.approx(figures["gain_naive_expected"], rel=0.1)
    assert figures["loop_gain_naive"] == pytest.approx(figures["loop_gain_naive_expected"], rel=0.1)
    assert figures["gain_naive"] > 1.5


def test_told_and_frozen_are_one_loop_on_a_still_ring(still):
    assert still.figures["rms_ratio_frozen"] == 1.0


def test_files_hold_figures_settings_and_series(still, tmp_path):
    write(still, tmp_path / "new")
    document = json.loads((tmp_path / "new" / "refit.json").read_text())
    for name in ("rms_ratio_ours", "rms_ratio_naive", "rms_ratio_frozen", "gain_ours"):
        assert document[name] == still.figures[name]
    assert document["seed"] == 4
    assert document["settings"]["policy"]["gain"] == 0.5
    assert len(document["series"]["true_rms_m"]["ours"]) == 800
    assert document["within_uncertainty_ours"]["within_two_sigma"] > 0.9
    assert (tmp_path / "new" / "refit.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.nightly
def test_drift_is_followed():
    figures = evaluate_refit(RefitEvaluationSettings(drift="paper", ticks=600, seed=5)).figures
    assert figures["rms_ratio_frozen"] != 1.0
    assert figures["rms_ratio_ours"] < 1.3


@pytest.mark.nightly
def test_same_seed_same_result(still):
    again = evaluate_refit(RefitEvaluationSettings(ticks=800, seed=4))
    for law, series in still.true_rms.items():
        assert np.array_equal(series, again.true_rms[law])


@pytest.mark.nightly
def test_begins_with_a_wrong_response_when_asked():
    settings = RefitEvaluationSettings(ticks=600, seed=6, start="drawn")
    figures = evaluate_refit(settings).figures
    assert figures["rms_ratio_frozen"] != 1.0
    assert figures["within_two_sigma_ours"] > 0.9
