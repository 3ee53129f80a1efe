"""The kick experiment without its processes: figures, responses, laws, files."""

import json

import numpy as np
import pytest

from orbitfb.core.signals import LoopState
from orbitfb.evaluate.kick.experiment import KickResult, KickRun
from orbitfb.evaluate.kick.figures import Recovery, mean_course, recoveries, recovery_figures
from orbitfb.evaluate.kick.laws import learn_settings, opening_policy
from orbitfb.evaluate.kick.report import table, write
from orbitfb.evaluate.kick.settings import KickSettings, responses
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant

UM = 1e-6
INFINITE = float("inf")


def run_of(*kicks_at, factor=0.5, ticks=200, floor=0.1 * UM):
    """A loop that halves the orbit at every tick, kicked to 200 µm."""
    rms = np.full(ticks, floor)
    for first in kicks_at:
        steps = np.arange(ticks - first)
        rms[first:] = np.maximum(200 * UM * factor**steps, floor)
    return rms


def test_a_recovery_begins_with_the_largest_step_after_the_request():
    found = recoveries(run_of(51, 102), asked=(50, 100), window=40)
    assert [recovery.tick for recovery in found] == [51, 102]
    assert all(recovery.kick == pytest.approx(200 * UM) for recovery in found)
    assert all(recovery.before == pytest.approx(0.1 * UM) for recovery in found)


def test_a_window_that_the_run_does_not_hold_is_left_out():
    assert len(recoveries(run_of(51, 171), asked=(50, 170), window=40)) == 1


def test_a_tick_that_the_loop_did_not_see_does_not_move_the_kick():
    rms = run_of(51)
    rms[60] = np.nan
    (found,) = recoveries(rms, asked=(50,), window=40)
    assert (found.tick, found.steps_to(50 * UM)) == (51, 2)


def test_steps_count_corrections_until_the_goal_is_first_reached():
    (found,) = recoveries(run_of(51), asked=(50,), window=40)
    assert found.steps_to(50 * UM) == 2  # 200, 100, 50
    assert found.steps_to(200 * UM) == 0
    assert found.steps_to(0.01 * UM) == INFINITE
    assert found.overshoot == pytest.approx(0.5)
    assert found.end == pytest.approx(0.1 * UM)


def test_a_kick_that_was_not_made_counts_as_never_recovered():
    found = recoveries(run_of(51), asked=(50,), window=40)
    figures = recovery_figures(found, planned=3)
    assert (figures["kicks"], figures["recovered"]) == (1.0, 1.0)
    assert figures["steps_to_near"] == figures["steps_to_near_worst"] == INFINITE
    assert recovery_figures(found, planned=1)["steps_to_near_worst"] == 2
    assert recovery_figures([], planned=2)["recovered"] == 0.0


def test_what_happened_after_the_loop_was_lost_is_not_known():
    rms = run_of(51, factor=1.1)
    rms[54:] = np.nan
    (found,) = recoveries(rms, asked=(50,), window=40)
    assert found.overshoot == pytest.approx(1.21)
    assert found.end == INFINITE


def test_mean_and_worst_course_leave_out_what_is_not_known():
    rows = (Recovery(0, np.array([4.0, 2.0, 1.0]), 0.0), Recovery(9, np.array([2.0, 6, np.nan]), 0))
    mean, worst = mean_course(rows)
    np.testing.assert_allclose(mean, [3.0, 4.0, 1.0])
    np.testing.assert_allclose(worst, [4.0, 6.0, 1.0])


def test_the_ring_is_at_the_end_of_its_drift_and_the_controllers_before_it():
    settings = KickSettings(error="mild", matrix_error=0.0, seed=3)
    known = responses(settings)
    plant = Plant(Ring.load(), "x", settings.plant(), 3)
    np.testing.assert_array_equal(known.believed, plant.nominal_response)
    np.testing.assert_array_equal(known.true, plant.response_at(5000))
    assert known.figures(settings.policy.svd)["relative_error"] > 0.02


def test_the_entry_error_is_as_large_as_stated_and_other_planes_stay_uncoupled():
    settings = KickSettings(error="none", matrix_error=2e-6, seed=3, planes="xy")
    known = responses(settings)
    error = known.believed - known.true
    assert np.std(error[known.true != 0]) == pytest.approx(2e-6, rel=0.02)
    assert not error[known.true == 0].any()
    figures = known.figures(settings.policy.svd)
    assert figures["error_over_weakest"] > 1.0


def test_without_error_nothing_is_wrong():
    settings = KickSettings(error="none", matrix_error=0.0)
    figures = responses(settings).figures(settings.policy.svd)
    assert figures["relative_error"] == figures["error_over_weakest"] == 0.0
    assert figures["growth_svd"] < 1.0


@pytest.mark.parametrize("error", ["mild", "strong"])
def test_the_stated_prior_is_as_large_as_the_error(error):
    settings = KickSettings(error=error, matrix_error=1e-6)
    known = responses(settings)
    prior = learn_settings(settings, known).identify
    size = np.mean(known.true**2)
    expected = prior.prior_entry**2 + prior.prior_relative**2 * size
    assert np.mean((known.believed - known.true) ** 2) == pytest.approx(expected, rel=1e-6)
    kept = settings.model_copy(update={"prior": "configured"})
    assert learn_settings(kept, known) == settings.learn


def test_those_that_are_told_begin_with_the_true_response_and_learners_with_caution():
    settings = KickSettings(error="mild", matrix_error=1e-6)
    known = responses(settings)
    policies = {law: opening_policy(law, settings, known) for law in settings.laws}
    for law in ("told", "told-network"):
        np.testing.assert_array_equal(policies[law].response, known.true)
    for law in ("svd", "adaptive", "network"):
        np.testing.assert_allclose(policies[law].response, known.believed, atol=1e-15)
    size = {law: np.linalg.norm(policy.gain_matrix) for law, policy in policies.items()}
    assert size["adaptive"] < size["svd"]


def result():
    rms = run_of(51, 101)
    found = tuple(recoveries(rms, asked=(50, 100), window=40))
    runs = {
        "told": KickRun(rms, found, 0, 0, LoopState.CLOSED, "", (), 200, 2),
        "svd": KickRun(np.full(200, np.nan), (), 1, 2, LoopState.TRIPPED, "it grew", (), 44),
        "adaptive": KickRun(
            np.full(200, np.nan), (), 1, 2, LoopState.TRIPPED, "it fell", (), 140, 1
        ),
    }
    wrong = {"relative_error": 0.034, "error_over_weakest": 83.6, "growth_svd": 0.97}
    return KickResult(KickSettings(kicks=2), wrong, runs)


def test_table_has_a_row_for_every_law_and_says_how_it_ended():
    lines = table(result()).splitlines()
    assert any(
        line.startswith("| SVD told the true R | 2 of 2 | 2 (2) | 9 (9) | 0.500 |")
        for line in lines
    )
    [frozen] = [line for line in lines if line.startswith("| SVD on the wrong R, frozen |")]
    assert "| 0 of 2, none made | not kicked | not kicked | not kicked | not kicked |" in frozen
    assert frozen.endswith("| TRIPPED at tick 44, before the first kick |")
    assert (
        "- SVD on the wrong R, frozen, TRIPPED at tick 44, before the first kick: it grew" in lines
    )
    [learning] = [line for line in lines if line.startswith("| SVD on the wrong R, learning |")]
    assert "| 0 of 2, 1 made | never (never) |" in learning
    assert learning.endswith("| TRIPPED at tick 140, after 1 of 2 kicks |")


def test_files_hold_figures_courses_and_settings(tmp_path):
    write(result(), tmp_path / "new")
    document = json.loads((tmp_path / "new" / "kick.json").read_text())
    assert document["wrong"]["relative_error"] == 0.034
    assert document["laws"]["told"]["steps_to_near"] == 2.0
    assert document["laws"]["svd"]["steps_to_near"] is None
    assert document["laws"]["svd"]["kicks_asked"] == 0.0
    assert document["laws"]["svd"]["ended_at_tick"] == 44.0
    assert (document["laws"]["svd"]["state"], document["laws"]["svd"]["reason"]) == (
        "TRIPPED",
        "it grew",
    )
    assert len(document["laws"]["told"]["courses_m"]) == 2
    assert document["settings"]["kicks"] == 2
    assert "# Random kicks" in (tmp_path / "new" / "kick.md").read_text()
    assert (tmp_path / "new" / "kick.png").read_bytes().startswith(b"\x89PNG")
