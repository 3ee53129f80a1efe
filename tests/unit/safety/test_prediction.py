"""Answers of the orbit: what is told of the response, and what is not."""

import numpy as np
import pytest

from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.prediction import Answers, answered, idle, predict
from orbitfb.safety.verdict import Action

S = InterlockSettings()
N = 40
OK = np.ones(N, dtype=bool)


def play(share, lag=0, drift=0.0, kicks=0.0, size=20e-6, ticks=12, shrinks=False, settings=S):
    """Send changes of a growing answer; the ring does a share of it. The gravest verdict."""
    random = np.random.default_rng(2)
    pattern, wind = random.standard_normal((2, N))
    memory, orbit, rms = Answers(), np.zeros(N), 1e-4
    for _ in range(3):
        memory = idle(orbit, OK, memory)
    sent = [np.zeros(N)] * (lag + 1)
    worst = Action.OK
    for tick in range(ticks):
        answer = size * (1 + tick) * pattern
        memory = predict(answer, memory, settings)
        sent.append(answer)
        orbit = orbit + share * sent[-1 - lag] + drift * wind
        orbit = orbit + kicks * tick**2 * pattern
        rms *= 0.9 if shrinks else 1.1
        verdict, memory = answered(orbit, OK, rms, memory, settings)
        worst = max(worst, verdict.action)
    return worst


@pytest.mark.parametrize("share", [-1.0, 0.0, 0.2])
def test_an_orbit_that_does_not_answer_trips(share):
    assert play(share) is Action.TRIP
    assert play(share, drift=1e-3) is Action.TRIP  # whatever drifts
    never = InterlockSettings(prediction_ticks=0)
    assert play(share, settings=never) is Action.OK


@pytest.mark.parametrize("lag", [0, 1, 2])
@pytest.mark.parametrize("share", [0.5, 1.0, 3.0])
def test_an_orbit_that_answers_does_not(share, lag):
    assert play(share, lag) is Action.OK
    assert play(share, lag, drift=1e-3) is Action.OK


def test_a_loop_that_helps_is_not_tripped_whatever_it_does():
    assert play(-1.0, shrinks=True) is Action.OK


def test_what_is_small_or_drowned_in_kicks_says_nothing():
    assert play(-1.0, size=1e-7) is Action.OK
    assert play(1.0, kicks=-1e-4) is Action.OK
