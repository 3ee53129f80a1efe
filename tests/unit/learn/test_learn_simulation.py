"""The simulation of laws that are not linear, against the recursion and by hand."""

from dataclasses import replace

import numpy as np
import pytest
from test_learn_judge import GROUND, READING, RESPONSE, model

from orbitfb.learn.forecast import predict_loop
from orbitfb.learn.judge import Evidence, is_linear, judge
from orbitfb.learn.settings import JudgeSettings
from orbitfb.learn.simulation import Scene, simulate
from orbitfb.policies.embedding import embed
from orbitfb.policies.modal import ModalPolicy, ModalSettings, kalman_gain

LAW = ModalSettings(reading_noise=READING, ground=GROUND)
KALMAN = float(kalman_gain(GROUND**2, READING**2))


def law(gains=KALMAN, threshold=5 * READING, response=RESPONSE):
    return ModalPolicy(response, LAW, gains=gains, thresholds=threshold)


def scene(ticks=4000, **changes):
    responses = np.repeat(RESPONSE[None], 8, axis=0)
    return replace(Scene(responses, model(RESPONSE), ticks, 100e-6, 12, 3), **changes)


def test_a_linear_law_is_simulated_as_it_is_predicted():
    policy = law(threshold=np.inf)
    predicted = predict_loop(policy.gain_matrix, [RESPONSE], model(RESPONSE), 4096)
    assert simulate(policy, scene()).rms == pytest.approx(predicted.rms, rel=0.03)


def test_after_a_kick_the_bent_law_is_quick_and_the_linear_one_slow():
    bent, slow = simulate(law(), scene(ticks=16)), simulate(law(threshold=np.inf), scene(ticks=16))
    assert bent.left < 0.01
    # The worst of eight draws of four numbers is up to twice the rms that was asked for.
    assert 1.0 < slow.left / (1 - KALMAN) ** 12 < 2.0
    assert bent.peak < 0.1  # one change corrects it


def test_what_diverges_is_finite_and_large():
    outcome = simulate(law(response=-RESPONSE), scene(ticks=400))
    assert outcome.rms > 1e-3 and np.isfinite(outcome.rms)
    assert outcome.left > 1.0


def test_linear_and_bent_are_told_apart():
    for policy, linear in ((law(threshold=np.inf), True), (law(), False), (embed(law()), False)):
        assert is_linear(policy, policy.gain_matrix, 100e-6) is linear


def verdict(candidate, incumbent, **settings):
    return judge(
        candidate,
        incumbent,
        model(RESPONSE),
        Evidence(0.0, 0.0),
        JudgeSettings(**settings),
        np.random.default_rng(1),
    )


def test_the_bent_law_beats_full_gain_and_the_network_is_judged_like_the_law():
    full = law(gains=1.0)
    said, again = verdict(law(), full), verdict(embed(law()), full)
    assert said.accepted and again.accepted
    for name, value in said.figures.items():
        assert again.figures[name] == pytest.approx(value, rel=1e-3, abs=1e-5), name


def test_a_law_that_makes_a_kick_grow_is_refused():
    """Harmless at the noise floor, where its gain is small; an overshoot far from it."""
    strong = ModalPolicy(RESPONSE / 3.2, LAW, gains=KALMAN / 3.2, thresholds=5 * READING)
    said = verdict(strong, law(gains=0.9), highest_peak=1.5)
    assert not said.accepted and "after a kick of 100 µm" in said.reason
    assert said.figures["growth_candidate"] < 1.0
