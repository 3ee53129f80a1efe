"""Why a setpoint is not what was sent, and when to ask for it."""

import numpy as np

from orbitfb.safety.bounds import Bounds
from orbitfb.safety.culprit import culprit
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.prediction import Answers
from orbitfb.safety.refusals import (
    FORGIVEN,
    Refusals,
    closely,
    doubtful,
    judge,
    settled,
    tolerance_of,
)

M = 4
RULES = InterlockSettings()
OTHER = np.arange(M) == 1
SENT = np.array([0.1, 0.31, 0.2, 0.0])
STATED = np.array([0.1, 0.05, 0.2, 0.0])
FREE = Bounds.of(10.0, M)


def judged(refusals=None, now=0.0, bounds=FREE, told=None):
    return judge(OTHER, STATED, SENT, bounds, told or {}, refusals or Refusals(), now, RULES)


def test_what_happened_once_without_a_cause_was_somebody():
    first = judged()
    assert first.moved.tolist() == OTHER.tolist() and not first.refusals.found


def test_what_happens_twice_is_a_corrector_that_does_not_keep_its_puts():
    first = judged(now=100.0)
    second = judged(first.refusals, now=100.0 + FORGIVEN)
    assert not second.moved.any()
    assert second.refusals.found == {1: "does not keep puts: reads 0.05 A after 0.31 A was sent"}
    late = judged(first.refusals, now=101.0 + FORGIVEN)
    assert late.moved.any() and not late.refusals.found


def test_puts_of_many_that_were_lost_are_no_single_corrector():
    every, sent, stated = np.ones(M, dtype=bool), np.full(M, 0.05), np.zeros(M)
    refusals = Refusals()
    for now in (0.0, 1.0, 2.0):
        small = judge(every, stated, sent, FREE, {}, refusals, now, RULES)
        assert not small.moved.any() and not small.refusals.found
        large = judge(every, stated, 10 * sent, FREE, {}, refusals, now, RULES)
        assert large.moved.all() and not large.refusals.found
        refusals = large.refusals


def test_a_put_that_the_server_refused_is_no_hand_at_the_setpoint():
    at_once = judged(told={1: "refuses puts: Channel write request failed"})
    assert not at_once.moved.any()
    assert at_once.refusals.found == {
        1: "refuses puts: Channel write request failed, reads 0.05 A after 0.31 A was sent"
    }


def test_one_that_was_clipped_to_its_drive_limit_is_well():
    drive = np.full((M, 2), np.nan)
    drive[1] = -0.05, 0.05
    again = Refusals(missed=np.zeros(M))
    clipped = judged(again, now=1.0, bounds=Bounds.of(10.0, M, drive))
    assert not clipped.moved.any() and not clipped.refusals.found
    drive[1] = -0.2, 0.2  # it lies at no limit: something else is wrong
    assert judged(bounds=Bounds.of(10.0, M, drive)).moved.any()


def test_a_readback_that_stays_away_by_little_is_worth_asking_and_noise_is_not():
    ours, recent = np.ones(M, dtype=bool), (np.zeros(M),)
    refusals = settled(Refusals(), np.full(M, 0.03), np.zeros(M))  # its calibration is off
    ticks = RULES.readback_ticks + RULES.readback_lag
    for sign in (1, -1) * ticks:  # one orbit in four
        asks, refusals = doubtful(np.full(M, 0.03 + 0.02 * sign), recent, ours, refusals, RULES)
        assert not asks
        for _ in range(3):
            _, refusals = doubtful(np.full(M, 0.03), recent, ours, refusals, RULES)
    told = []
    for _ in range(ticks):
        asks, refusals = doubtful(np.full(M, 0.05), recent, ours, refusals, RULES)
        told.append(asks)
    assert told == [False] * (ticks - 1) + [True]
    asks, _ = doubtful(np.full(M, 0.05), recent, ~ours, refusals, RULES)
    assert not asks
    refusals = settled(Refusals(), np.full(M, 0.03), np.zeros(M))
    told = []
    for tick in range(4 * ticks):  # taken back every other tick
        at = np.full(M, 0.05 if tick % 2 else 0.03)
        asks, refusals = doubtful(at, recent, ours, refusals, RULES)
        told.append(asks)
    assert any(told)


def test_before_the_response_is_called_wrong_one_small_difference_counts_and_rounding_does_not():
    alone = np.array([0.0, 0.0094, 0.0, 0.0])
    response = np.full((5, M), 1.2e-3)
    assert (np.abs(alone) <= tolerance_of(RULES)).all()
    assert (np.abs(alone) > closely(alone, response, RULES)).tolist() == [False, True, False, False]
    rounding = np.array([0.004, -0.002, 0.003, -0.0049])  # the last digit of a coarse converter
    assert not (np.abs(rounding) > closely(rounding, response, RULES)).any()


N = 30
RESPONSE = np.random.default_rng(3).standard_normal((N, M)) * 1e-4


def blamed(actual, asked=None):
    """Who is to blame when `actual` of `asked` [A] acts."""
    asked = np.array([0.1, 1.0, -0.15, 0.1]) if asked is None else asked
    answers = Answers((RESPONSE @ asked,), np.zeros(N), np.zeros(N), np.ones(N, dtype=bool))
    every = np.ones(M, dtype=bool)
    position = RESPONSE @ actual(asked)
    return culprit(position, np.ones(N, dtype=bool), answers, RESPONSE, every, RULES)


def without_1(asked):
    return np.where(np.arange(M) == 1, 0.0, asked)


def test_one_corrector_that_does_nothing_or_the_wrong_thing_is_found():
    assert blamed(without_1) == 1
    assert blamed(lambda asked: np.where(np.arange(M) == 1, -asked, asked)) == 1


def test_a_wrong_response_is_nobodys_fault():
    assert blamed(lambda asked: -asked) is None
    assert blamed(lambda asked: asked[[1, 0, 3, 2]]) is None
    assert blamed(lambda asked: 0.0 * asked) is None
    # nothing is told of the others while they do not move
    assert blamed(without_1, np.array([0.0, 1.0, 0.0, 0.0])) is None
