"""The judge: what it predicts against a simulation, and each of its refusals."""

import numpy as np
import pytest

from orbitfb.core.errors import ConfigError
from orbitfb.learn.forecast import Prediction, paired_gain, predict_loop, predict_pairs, student
from orbitfb.learn.judge import Evidence, gain_of, judge
from orbitfb.learn.reach import needed_change
from orbitfb.learn.settings import JudgeSettings
from orbitfb.models.linear import LinearModel
from orbitfb.policies.svd import SvdPolicy, SvdSettings

READING = 0.2e-6
GROUND = 0.05e-6


def model(response, sigma=1e-9, creep=0.0):
    n, m = response.shape
    return LinearModel(
        response=response,
        modes=np.eye(n),
        levels=np.zeros(n, dtype=np.intp),
        covariances=sigma**2 * np.eye(m)[None],
        reading_variance=READING**2,
        ground_variances=np.full(n, GROUND**2),
        creep=np.full(n, creep),
    )


RESPONSE = 1e-3 * np.diag([3.0, 1.0, 0.5, 0.2])
GOOD = 0.5 * np.linalg.inv(RESPONSE)


class Proportional:
    policy_id = "proportional"

    def __init__(self, gain):
        self.gain_matrix = gain


def verdict(candidate, incumbent, nats=0.0, settings=None, sigma=1e-9, page=0.0, cost=0.0):
    return judge(
        Proportional(candidate),
        Proportional(incumbent),
        model(RESPONSE, sigma),
        Evidence(nats, page),
        settings or JudgeSettings(),
        np.random.default_rng(1),
        cost,
    )


@pytest.mark.parametrize("creep", [0.0, 0.1e-6])
def test_prediction_equals_simulation(creep):
    generator = np.random.default_rng(2)
    gain = GOOD * np.array([1.0, 0.8, 0.3, 0.1])[:, None]
    orbit = np.zeros((4000, 4))
    for _ in range(256):
        reading = orbit + READING * generator.standard_normal(orbit.shape)
        orbit = orbit - reading @ (RESPONSE @ gain).T
        orbit += GROUND * generator.standard_normal(orbit.shape) + creep
    predicted = predict_loop(gain, [RESPONSE], model(RESPONSE, creep=creep), 256)
    assert predicted.rms == pytest.approx(np.sqrt(np.mean(orbit**2)), rel=0.02)


def test_growth_is_the_spectral_radius():
    gain = GOOD.copy()
    gain[3, 3] *= -0.02
    predicted = predict_loop(gain, [RESPONSE], model(RESPONSE), 512)
    radius = np.max(np.abs(np.linalg.eigvals(np.eye(4) - RESPONSE @ gain)))
    assert predicted.growth == pytest.approx(radius, rel=1e-3)
    assert radius > 1


def test_a_diverging_loop_is_predicted_finite():
    predicted = predict_loop(-40 * GOOD, [RESPONSE], model(RESPONSE), 8192)
    assert np.isfinite(predicted.rms)


def test_accepts_what_is_better():
    weak = 0.01 * GOOD
    said = verdict(GOOD, weak)
    assert said.accepted
    assert "better by" in said.reason
    assert said.figures["predicted_rms_candidate"] < said.figures["predicted_rms_incumbent"]


@pytest.mark.parametrize(
    ("candidate", "nats", "settings", "words"),
    [
        (GOOD, 0.0, JudgeSettings(margin=0.002), "below the 0.2 % that a swap costs"),
        (0.01 * GOOD, 0.0, JudgeSettings(), "the gain is below"),
        (-GOOD, 0.0, JudgeSettings(), "would grow"),
        (
            GOOD,
            -50.0,
            JudgeSettings(),
            "new data fit the present response better than the candidate's, by 50.0 nats",
        ),
        (2.2 * GOOD, 0.0, JudgeSettings(change_limit=1e-3), "would change the setpoints"),
        (np.full((4, 4), np.nan), 0.0, JudgeSettings(), "not finite"),
    ],
)
def test_refuses_with_a_reason(candidate, nats, settings, words):
    said = verdict(candidate, GOOD, nats, settings)
    assert not said.accepted
    assert words in said.reason


STRICT = JudgeSettings(change_limit=1e-3)


def test_an_incumbent_with_a_low_gain_does_not_lock_out_what_the_ring_calls_for():
    said = verdict(GOOD, 0.01 * GOOD, settings=STRICT)
    assert said.figures["change_rms"] > 10 * STRICT.change_limit
    assert said.accepted


def test_a_change_is_needed_only_as_far_as_the_response_is_known():
    """The same law for the same ring, but the data show no more than its two strongest modes."""
    said = verdict(GOOD, 0.01 * GOOD, settings=STRICT, sigma=0.5e-3)
    assert not said.accepted
    assert "would change the setpoints" in said.reason


def test_the_change_that_is_needed_is_that_of_the_inverse_over_what_moves():
    movable = np.array([True, True, False, True])
    gains = 1e3 / np.array([3.0, 1.0, 0.2])
    expected = 1e-4 * np.sqrt(np.sum(gains**2) / 4)
    assert needed_change(model(RESPONSE), movable, 1e-4) == pytest.approx(expected, rel=1e-3)
    assert needed_change(model(RESPONSE), movable & False, 1e-4) == 0.0


def test_what_is_not_known_counts_against_a_bold_law():
    """With the weakest mode unknown, a law that trusts it loses to one that leaves it alone."""
    timid = GOOD.copy()
    timid[3, 3] = 0.0
    assert verdict(GOOD, timid, sigma=1e-9).accepted
    assert not verdict(GOOD, timid, sigma=0.4e-3).accepted


def test_asks_a_policy_without_a_gain_matrix():
    policy = SvdPolicy(RESPONSE, SvdSettings())

    class Opaque:
        policy_id = "opaque"
        initial_state = policy.initial_state
        act = policy.act

    assert np.allclose(gain_of(Opaque(), 4), policy.gain_matrix)


def half_known(sigma=0.3e-3):
    """A candidate that gains on most responses that the data allow, and not on all."""
    timid = GOOD.copy()
    timid[3, 3] *= 0.5
    return {"candidate": GOOD, "incumbent": timid, "sigma": sigma}


def test_a_gain_that_is_not_resolved_is_refused_unless_the_rows_refute_the_incumbent():
    lenient = verdict(**half_known(), settings=JudgeSettings(resolved=False, margin=0.0))
    figures = lenient.figures
    assert figures["gain_low"] < 0.0 < figures["gain_high"]
    if lenient.accepted:
        said = verdict(**half_known(), settings=JudgeSettings(margin=0.0))
        assert not said.accepted and "not resolved" in said.reason
        told = verdict(**half_known(), settings=JudgeSettings(margin=0.0), page=12.0)
        assert told.accepted and "refute the incumbent's response by 12.0 nats" in told.reason


def test_a_gain_that_a_swap_costs_is_refused():
    weak = 0.9 * GOOD
    gain = verdict(GOOD * 0.8, GOOD).figures["gain"]
    assert gain > 0.0
    assert verdict(GOOD * 0.8, GOOD, cost=0.9 * gain).accepted
    refused = verdict(GOOD * 0.8, GOOD, cost=1.1 * gain, page=1e3)
    assert not refused.accepted and "that a swap costs" in refused.reason
    assert weak is not GOOD


def test_the_interval_is_that_of_one_more_response():
    ours = Prediction(1.0, 0.5, np.array([1.0, 1.1, 0.9]))
    theirs = Prediction(1.2, 0.5, np.array([1.2, 1.21, 1.17]))
    ratios = np.log(theirs.each / ours.each)
    half = student(2) * np.std(ratios, ddof=1) * np.sqrt(4 / 3)
    gain = paired_gain(ours, theirs)
    assert gain.mean == pytest.approx(1 / 6)
    assert gain.low == pytest.approx(1 - np.exp(-(ratios.mean() - half)))
    assert gain.high == pytest.approx(1 - np.exp(-(ratios.mean() + half)))
    assert student(5) == pytest.approx(2.5706, abs=1e-4)
    one = paired_gain(Prediction(1.0, 0.5, np.ones(1)), Prediction(2.0, 0.5, np.ones(1)))
    assert one.low == -np.inf  # one response resolves nothing


def test_one_response_on_which_a_gain_does_not_pay_decides_where_it_must_be_resolved():
    """No further response is drawn, and the interval would have said the same."""
    responses = [scale * 1e-3 * np.eye(4) for scale in (1.0, 0.5, 1.1, 0.9)]
    ours, theirs = 500.0 * np.eye(4), 600.0 * np.eye(4)
    arguments = (ours, theirs, model(1e-3 * np.eye(4)), 64)
    few, *_ = predict_pairs(*arguments, iter(responses), 0.03)
    every, mine, others = predict_pairs(*arguments, iter(responses), None)
    assert len(every) == 4
    assert len(few) < 4
    assert paired_gain(mine, others).low < 0.03


class Remembering(Proportional):
    """Has a memory, so that it does not decide on many orbits at once."""

    def changes(self, errors):
        raise ConfigError("it decides by earlier orbits")


def test_a_law_with_a_memory_is_judged_by_its_gain():
    said = [
        judge(
            law(GOOD), Proportional(0.01 * GOOD), model(RESPONSE), Evidence(0.0, 0.0),
            JudgeSettings(), np.random.default_rng(1),
        ).figures
        for law in (Proportional, Remembering)
    ]  # fmt: skip
    assert said[0] == said[1]
