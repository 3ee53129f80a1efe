"""Correctors that do not follow: left out, too many of them trip; either sign counts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orbitfb.safety.bpms import BpmMemory, Flaw, screen
from orbitfb.safety.correctors import follow
from orbitfb.safety.interlocks import InterlockSettings, not_following, orbit_distortion
from orbitfb.safety.verdict import Action

S = InterlockSettings(readback_ticks=2, max_lost_correctors=2)
M = 6
NAMES = [f"C{i}" for i in range(M)]


def after(off, ticks, readback=0.0, lost=(), **how):
    """Let some correctors be off for some ticks; what is said last."""
    mask, value = np.isin(np.arange(M), off), np.full(M, float(readback))
    out, counts = np.isin(np.arange(M), lost), np.zeros(M, dtype=np.int64)
    sure = None
    for _ in range(ticks):
        said = follow(mask, value, counts, out, S, NAMES, sure=sure, **how)
        counts, out, sure = said.counts, said.lost, said.sure
    return said


def test_one_that_is_off_is_left_out_after_its_ticks_and_named():
    first, second = after([1], 1), after([1], 2)
    assert first.verdict.action is Action.WARN and not first.lost.any()
    assert second.verdict.reason == "1 correctors do not follow and are left out: C1"
    assert second.verdict.action is Action.WARN and second.lost.tolist() == [0, 1, 0, 0, 0, 0]


def test_one_that_is_left_out_stays_out_when_it_seems_to_follow_again():
    assert after([], 5, lost=[1]).lost[1]


def test_too_many_trip_but_hold_while_their_ioc_may_come_back():
    assert after([0, 1, 2], 2).verdict.action is Action.TRIP
    assert after([0, 1, 2], 2, readback=np.nan).verdict.action is Action.HOLD
    assert after([0], 2, lost=[4, 5]).verdict.action is Action.TRIP


def test_many_that_are_back_have_as_many_ticks_to_follow_as_any_other():
    off, value = np.isin(np.arange(M), [0, 1, 2]), np.where(np.arange(M) < 3, np.nan, 0.0)
    said = after([], 1)
    for readback, wanted in ((value, "HOLD"), (np.zeros(M), "HOLD"), (np.zeros(M), "TRIP")):
        for _ in range(1 if readback is not value else 7):
            said = follow(off, readback, said.counts, said.lost, S, NAMES, sure=said.sure)
        assert said.verdict.action is Action[wanted]


def test_a_loop_that_does_not_write_is_kept_from_closing_at_once():
    assert after([0], 1, acting=False).verdict.action is Action.HOLD
    assert after([0], 2, leaves_out=False).verdict.action is Action.HOLD
    held = after([0], 1, held=True)
    assert held.verdict.action is Action.HOLD  # not back before it is known to be lost
    assert after([0], 2, held=True).verdict.action is Action.WARN


def test_one_that_cannot_be_written_is_left_out_at_once_and_may_come_back():
    away = np.isin(np.arange(M), [1])
    assert after([], 1, away=away).lost.tolist() == [0, 1, 0, 0, 0, 0]
    assert after([], 1, away=away, acting=False).verdict.action is Action.HOLD
    assert after([], 1, away=away, held=True).verdict.action is Action.WARN
    many = np.isin(np.arange(M), [1, 2, 3])
    assert after([], 1, away=many).verdict.action is Action.HOLD  # not TRIP: it may come back
    assert after([], 1, lost=[1], away=away).lost.sum() == 1


@given(st.lists(st.sets(st.integers(0, M - 1)), min_size=1, max_size=20))
def test_never_more_are_left_out_than_may_be_and_none_comes_back_by_itself(offs):
    counts, lost = np.zeros(M, dtype=np.int64), np.zeros(M, dtype=bool)
    for off in offs:
        said = follow(np.isin(np.arange(M), list(off)), np.zeros(M), counts, lost, S)
        assert said.lost[lost].all() and np.count_nonzero(said.lost) <= S.max_lost_correctors
        assert said.verdict.action is not Action.OK or not said.lost.any()
        counts, lost = said.counts, said.lost


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_dead_band_looks_at_both_signs(sign):
    """What is too far below is as bad as what is too far above: readback, jump, orbit."""
    inside, beyond = np.array([sign * 0.09]), np.array([sign * 0.11])
    assert not not_following(inside, [np.zeros(1)], S).any()
    assert not_following(beyond, [np.zeros(1)], S).all()
    memory = BpmMemory.first(5, S)
    ok, orbit = np.ones(5, dtype=bool), np.full(5, 1e-6)
    _, memory = screen(orbit, orbit, ok, memory, S)
    moved = orbit + 1e-9
    moved[2] = sign * 300e-6
    assert screen(moved, moved, ok, memory, S)[0].tolist() == [0, 0, Flaw.JUMP, 0, 0]
    error = np.array([sign * 5e-3, 0.0])
    assert orbit_distortion(0.0, float(np.abs(error).max()), S).action is Action.TRIP
