"""The change detector: its false alarms, what it must not take for a drift, and the ring."""

import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[3]
sys.path.insert(0, str(ROOT))
from benchmarks.false_alarms import (  # noqa: E402
    first_alarm,
    passages,
    through_detector,
    worst_case,
)
from orbitfb.models.changes import (  # noqa: E402
    ChangeDetector,
    blocks_between_alarms,
    fewest_blocks,
    threshold_for,
)
from orbitfb.models.comparison import Comparison, Contrast  # noqa: E402
from orbitfb.models.filter import PrefilterBank  # noqa: E402
from orbitfb.models.noise import LADDER  # noqa: E402
from orbitfb.models.settings import ChangeSettings, IdentifySettings  # noqa: E402
from orbitfb.physics.drift import DriftSettings  # noqa: E402

NOISE = 0.2e-6
ENTRY = 1e-6
SETTINGS = IdentifySettings(change_entry=ENTRY, change_memory=1e9, ground=0.02e-6)


def contrast(pull=0.0, information=0.0, rows=20, chi2=1.0, sensitivity=100.0):
    return Contrast(rows, pull, information, sensitivity, chi2)


@pytest.mark.parametrize("information", [0.3, 1.0, 3.0])
def test_the_closed_form_agrees_with_drawn_walks(information):
    threshold = 4.0
    steps = np.random.default_rng(1).standard_normal(400_000) * np.sqrt(information)
    found = passages(steps - 0.5 * information, threshold)
    expected = len(steps) / blocks_between_alarms(threshold, information)
    assert found == pytest.approx(expected, rel=0.15)


def test_the_threshold_is_solved_for_the_worst_information():
    threshold = threshold_for(1e5)
    fewest, worst = fewest_blocks(threshold)
    assert fewest == pytest.approx(1.1e5, rel=1e-6)
    for information in (0.1 * worst, 0.5 * worst, 2.0 * worst, 10.0 * worst):
        assert blocks_between_alarms(threshold, information) > fewest


def test_false_alarms_in_the_worst_case_are_as_stated():
    stated = 100.0
    found = worst_case(3, 7, ChangeSettings(false_alarms_per_day=stated))
    assert found <= 3 * stated + 3 * np.sqrt(3 * stated)
    assert found >= 0.5 * 3 * stated


@pytest.mark.parametrize("noise", [1.0, 1.05, 1.5])
def test_no_false_alarm_in_a_day_of_blocks_whatever_the_noise(noise):
    assert through_detector(1, 3, 3.0, noise, kicks_per_hour=1.0) <= 1


@pytest.mark.nightly
def test_false_alarms_of_twenty_days():
    assert worst_case(20, 0) <= 20 + 3 * np.sqrt(20)
    for information in (0.002, 0.3, 3.0):
        for noise in (1.0, 1.05):
            assert through_detector(20, 1, information, noise, kicks_per_hour=1.0) <= 20


def test_a_change_is_found_after_the_evidence_it_makes():
    detector = ChangeDetector(ChangeSettings(), 10.0)
    blocks = 0
    alarm = None
    while alarm is None:
        alarm = detector.absorb(contrast(pull=1.0, information=1.0))
        blocks += 1
    per_block = 0.5 - 20 * detector.settings.allowance
    assert blocks == int(np.ceil(detector.threshold / per_block))
    assert alarm.rows == alarm.rising == 20 * blocks
    assert f"{alarm.evidence:.1f} nats" in alarm.reason


def test_one_huge_block_is_a_kick_and_no_drift():
    detector = ChangeDetector(ChangeSettings(), 10.0)
    assert detector.absorb(contrast(pull=1e6, information=1.0)) is None
    for _ in range(100):
        assert detector.absorb(contrast()) is None
    assert detector.evidence == pytest.approx(0.0)


def test_waits_for_rows_that_are_worth_something():
    detector = ChangeDetector(ChangeSettings(minimum_sensitivity=50.0), 10.0)
    for _ in range(49):
        assert detector.absorb(contrast(pull=5.0, sensitivity=1.0)) is None
    assert detector.evidence > detector.threshold and not detector.informed
    assert detector.absorb(contrast(pull=5.0, sensitivity=1.0)) is not None


def test_a_reset_forgets_and_empty_blocks_say_nothing():
    detector = ChangeDetector(ChangeSettings(), 10.0)
    while detector.absorb(contrast(pull=5.0)) is None:
        pass
    detector.reset()
    assert (detector.evidence, detector.rows, detector.sensitivity) == (0.0, 0, 0.0)
    assert detector.absorb(Contrast()) is None
    assert detector.rows == 0


def rows_in_closed_loop(response, truth, count, seed):
    """Prefiltered rows of a loop a = −½ R⁺ y on a ring whose response is `truth`."""
    generator = np.random.default_rng(seed)
    n, m = response.shape
    gain = 0.5 * np.linalg.pinv(response)
    ground = np.sqrt(LADDER[5] ** 2 / (1 - LADDER[5])) * NOISE
    orbit, changes, readings = np.zeros(n), [], []
    for _ in range(count + 1):
        reading = orbit + NOISE * generator.standard_normal(n)
        change = -gain @ reading
        orbit = orbit + truth @ change + ground * generator.standard_normal(n)
        changes.append(change)
        readings.append(reading)
    bank = PrefilterBank(LADDER)
    both = np.concatenate([np.array(changes)[:-1], np.diff(readings, axis=0)], axis=1)
    filtered, weights, _ = bank.run(both, np.arange(count) == 0, bank.start(m + n))
    filtered *= weights[:, :, None]
    return filtered[:, :, :m], filtered[:, :, m:]


def compare(response, truth, count, seed, settings=SETTINGS, modes=None):
    regressors, responses = rows_in_closed_loop(response, truth, count, seed)
    modes = np.eye(len(response)) if modes is None else modes
    comparison = Comparison(modes.T @ response, settings)
    responses = responses @ modes
    found = [
        comparison.absorb(regressors[:, begin : begin + 20], responses[:, begin : begin + 20])
        for begin in range(0, count, 20)
    ]
    return sum(c.pull for c in found), sum(c.information for c in found)


@pytest.mark.nightly
def test_pull_is_noise_of_the_stated_size_while_the_response_is_right():
    response = 1e-3 * np.eye(8) + 1e-4 * np.random.default_rng(3).standard_normal((8, 8))
    scores = []
    for seed in range(8):
        pull, information = compare(response, response, 2000, seed)
        scores.append(pull / np.sqrt(information))
    assert abs(np.mean(scores)) < 3.5 / np.sqrt(8)
    assert 0.4 < np.std(scores) < 1.9


def test_pull_is_the_information_when_the_change_is_of_the_expected_size():
    """The likelihood ratio is calibrated: over changes drawn from the prior, E pull = E I."""
    response = 1e-3 * np.eye(8) + 1e-4 * np.random.default_rng(3).standard_normal((8, 8))
    generator = np.random.default_rng(5)
    size = 1e-4
    settings = SETTINGS.model_copy(update={"change_entry": size})
    total = np.zeros(2)
    for seed in range(8):
        change = size * generator.standard_normal((8, 8))
        np.fill_diagonal(change, 0.0)
        total += compare(response, response + change, 1000, seed, settings)
    assert total[0] == pytest.approx(total[1], rel=0.1)
    assert total[1] > 20.0


def test_the_answer_to_a_kick_does_not_outweigh_all_other_rows():
    response = 1e-3 * np.eye(8)
    regressors, responses = rows_in_closed_loop(response, response, 400, 1)
    comparison = Comparison(response, SETTINGS)
    for begin in range(0, 380, 20):
        usual = comparison.absorb(
            regressors[:, begin : begin + 20], responses[:, begin : begin + 20]
        )
    kicked = regressors[:, 380:].copy()
    kicked[:, 10] *= 1000.0
    answered = responses[:, 380:] + (kicked - regressors[:, 380:]) @ response.T
    assert comparison.absorb(kicked, answered).sensitivity < 3.0 * usual.sensitivity


def test_a_larger_response_of_the_modes_themselves_is_left_out():
    """It looks like a misjudged Kalman gain, which is no change of R."""
    response = 1e-3 * np.eye(8) + 1e-4 * np.random.default_rng(3).standard_normal((8, 8))
    settings = SETTINGS.model_copy(update={"change_entry": 1e-4})
    left, _, right = np.linalg.svd(response)
    still, _ = compare(response, response, 2000, 1, settings, left)
    by_own, by_others = 0.0, 0.0
    for seed in (4, 5, 6):
        sizes = 1e-4 * np.random.default_rng(seed).standard_normal(8)
        own = left @ np.diag(sizes) @ right
        others = left @ np.roll(np.diag(sizes), 1, axis=1) @ right
        by_own += abs(compare(response, response + own, 2000, 1, settings, left)[0] - still)
        by_others += abs(compare(response, response + others, 2000, 1, settings, left)[0] - still)
    assert by_others > 40.0
    assert by_own < 0.1 * by_others


@pytest.mark.nightly
def test_the_ring_drifting_strongly_alarms_long_before_the_mean_square_does():
    drift = DriftSettings.model_validate({"preset": "strong"})
    tick, chi2, _ = first_alarm(drift, 2, 2000)
    assert tick is not None and tick < 1000
    assert chi2 < 1.1


@pytest.mark.nightly
def test_the_ring_as_it_was_does_not_alarm():
    assert first_alarm(DriftSettings(), 1, 1000)[0] is None
