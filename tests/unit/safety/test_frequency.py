"""When the RF frequency is stepped, by how much, and when the loop lets go of it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from orbitfb.safety.frequency import (
    ANSWERS,
    DRIFT_TICKS,
    Frequency,
    Pattern,
    SentStep,
    answer,
    closed,
    compare,
    next_step,
    noted,
    stepped,
)
from orbitfb.safety.rf_settings import RfSettings

HOME, NOISE, N = 5e8, 0.2e-6, 50
SETTINGS = RfSettings()
ORBIT = np.full(N, 1e-6)
PATTERN = Pattern(ORBIT, np.ones(4), energy=8e-6)
VALID = np.ones(N, dtype=bool)
NONE = (math.nan, math.nan)
QUIET = (0.0,) * (DRIFT_TICKS + 1)
PROVED = Frequency(np.zeros(4), HOME, energy=0.0, energies=QUIET, shares=(1.0,) * ANSWERS)


def step(memory: Frequency, energy: float, now: float = 100.0, limits=NONE, settings=SETTINGS):
    memory = replace(memory, energy=energy)
    return next_step(memory, PATTERN, VALID, now, limits, NOISE, settings)


def test_within_the_dead_band_nothing_moves_and_beyond_it_all_is_taken_over():
    assert step(PROVED, 1.9e-6)[0] == 0.0
    assert step(PROVED, math.nan)[0] == 0.0
    assert step(PROVED, 4e-6)[0] == pytest.approx(-0.5)
    assert step(PROVED, -4e-6)[0] == pytest.approx(0.5)


def test_a_step_is_no_larger_than_allowed_and_comes_no_sooner():
    assert step(PROVED, -8e-5)[0] == SETTINGS.largest_step
    just = stepped(PROVED, 0.5, 99.5, 4e-6)
    assert step(just, -8e-5)[0] == 0.0
    assert step(just, -8e-5, now=100.6)[0] == SETTINGS.largest_step
    assert just.asked == HOME + 0.5 and just.count == 1


def test_until_three_answers_are_in_a_step_is_as_long_as_can_be_told():
    first = replace(PROVED, shares=(1.0,) * (ANSWERS - 1))
    size, _ = step(first, -8e-5)
    assert size == pytest.approx(6.0 * math.sqrt(2.0) * NOISE / (1e-6 * math.sqrt(N)))


@pytest.mark.parametrize(
    ("memory", "limits", "settings", "words"),
    [
        (PROVED, (HOME - 1.0, HOME + 0.2), SETTINGS, "beyond the drive limits"),
        (stepped(PROVED, 4.9, 0.0, 4e-5), NONE, RfSettings(range=5.0), "rf.range is 5 Hz"),
        (replace(PROVED, steps=(0.5, -0.5, 0.5, -0.5)[1:]), NONE, SETTINGS, "to and fro"),
    ],
)
def test_it_lets_go_rather_than_go_too_far(memory, limits, settings, words):
    hertz, after = step(memory, -4e-6, limits=limits, settings=settings)
    assert hertz == 0.0 and words in after.stopped
    assert step(after, -8e-5, now=1e6)[0] == 0.0  # for good
    assert closed(after).stopped == ""


def answered(share: float, hertz: float = 0.5, memory: Frequency = PROVED) -> Frequency:
    random = np.random.default_rng(1)
    before, moved = 1e-4 * random.standard_normal(N), 1e-5 * random.standard_normal(N)
    after = before + moved + share * hertz * ORBIT + NOISE * random.standard_normal(N)
    memory = replace(memory, sent=SentStep(hertz, before, VALID, moved))
    return answer(memory, after, VALID, PATTERN, NOISE)


def test_the_orbit_must_answer_beyond_what_the_correctors_do():
    after = answered(1.0)
    assert after.shares[-1] == pytest.approx(1.0, abs=0.3) and not after.stopped
    assert after.sent is None


@pytest.mark.parametrize("share", [-1.0, 0.0, 3.0])
def test_a_wrong_sign_or_no_answer_is_found_out_by_the_third_step(share: float):
    memory = replace(PROVED, shares=())
    for _ in range(ANSWERS):
        assert not memory.stopped
        memory = answered(share, memory=memory)
    assert "does not answer the RF as the dispersion says" in memory.stopped


def test_one_kick_of_the_beam_does_not_decide():
    memory = answered(1.0, memory=answered(-40.0))
    assert not memory.stopped and len(memory.shares) == ANSWERS


def drifting(per_tick: float, memory: Frequency = PROVED) -> Frequency:
    for tick in range(DRIFT_TICKS + 1):
        memory = noted(memory, per_tick * tick)
    return memory


@pytest.mark.parametrize("hertz", [0.5, -0.5])
def test_what_drifts_meanwhile_is_no_answer(hertz: float):
    """0.4 Hz of energy a tick: the orbit moves by 0.8 or -0.8 of a right answer besides."""
    memory = drifting(0.4 * PATTERN.energy)
    assert memory.drift == pytest.approx(0.4 * PATTERN.energy)
    assert answered(1.0 + 0.4 / hertz, hertz, memory).shares[-1] == pytest.approx(1.0, abs=0.3)
    assert answered(0.4 / hertz, hertz, memory).shares[-1] == pytest.approx(0.0, abs=0.3)


def test_a_step_is_no_drift_and_none_is_made_before_the_drift_is_known():
    memory = stepped(drifting(1e-7), 0.5, 10.0, 4e-6)
    assert noted(memory, 1e-7 * (DRIFT_TICKS + 1) + 4e-6).drift == pytest.approx(1e-7)
    early = replace(PROVED, energies=QUIET[1:])
    assert step(early, -8e-5)[0] == 0.0


def test_a_step_that_is_too_short_says_nothing():
    assert answered(-1.0, hertz=0.01).shares == PROVED.shares


def test_the_frequency_is_where_it_was_put_or_the_loop_lets_go():
    memory = stepped(PROVED, 0.5, 10.0, 4e-6)
    aim = HOME + 0.5
    assert compare(memory, aim, aim, 13.0, SETTINGS).stopped == ""
    under_way = compare(memory, HOME, HOME, 11.0, SETTINGS)
    assert under_way.waits and not under_way.stopped
    assert step(under_way, -8e-5)[0] == 0.0
    assert "somebody else sets" in compare(memory, HOME, HOME, 13.0, SETTINGS).stopped
    assert "does not follow" in compare(memory, aim, HOME, 13.0, SETTINGS).stopped
    assert compare(memory, aim, None, 13.0, SETTINGS).stopped == ""  # there is no readback


def test_what_is_not_known_is_waited_for():
    memory = stepped(PROVED, 0.5, 10.0, 4e-6)
    for setpoint, readback in ((math.nan, HOME), (HOME + 0.5, math.nan)):
        waits = compare(memory, setpoint, readback, 13.0, SETTINGS)
        assert waits.waits and not waits.stopped and step(waits, -8e-5)[0] == 0.0
    assert compare(waits, HOME + 0.5, HOME + 0.5, 14.0, SETTINGS).waits == ""
