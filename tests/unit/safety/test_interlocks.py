import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orbitfb.safety.bpms import bpm_quota
from orbitfb.safety.interlocks import (
    InterlockSettings,
    not_following,
    orbit_distortion,
    stored_current,
)
from orbitfb.safety.verdict import FINE, Action, Verdict, name_some, worst

S = InterlockSettings()
NAN = float("nan")


@given(current=st.floats())
def test_only_a_known_sufficient_current_is_fine(current):
    verdict = stored_current({"current": current}, S)
    fine = bool(np.isfinite(current) or current > 0) and current >= S.current_min
    assert verdict.action is (Action.OK if fine else Action.TRIP)
    assert bool(verdict.reason) != fine


def test_an_absent_current_trips_or_holds_as_told_but_a_low_one_always_trips():
    assert stored_current({}, S).action is Action.TRIP
    assert stored_current({}, S, unknown=Action.HOLD).action is Action.HOLD
    assert stored_current({"current": 0.0}, S, unknown=Action.HOLD).action is Action.TRIP
    assert stored_current({}, InterlockSettings(current_min=None)) is FINE


@given(before=st.floats(0.1, 1.0), kept=st.floats(0.0, 1.2))
def test_a_current_that_drops_by_more_than_may_be_lost_trips_though_it_is_enough(before, kept):
    now = before * kept
    dropped = now < S.current_min or now < (1 - S.current_drop) * before
    verdict = stored_current({"current": now}, S, before=before)
    assert verdict.action is (Action.TRIP if dropped else Action.OK)


def test_a_drop_is_told_with_both_currents_and_looked_at_only_where_it_is_wanted():
    said = stored_current({"current": 0.25}, S, before=0.4)
    assert said.reason == "the stored current dropped from 400 to 250 mA"
    never = InterlockSettings(current_drop=1.0)
    assert stored_current({"current": 0.02}, never, before=0.4) is FINE


@given(rms=st.floats(), largest=st.floats())
def test_distortion_lets_pass_only_what_is_known_to_be_small(rms, largest):
    fine = rms <= S.distortion_rms and largest <= S.distortion_max
    assert orbit_distortion(rms, largest, S).action is (Action.OK if fine else Action.TRIP)


@pytest.mark.parametrize(
    ("invalid", "action"),
    [(0, Action.OK), (1, Action.WARN), (9, Action.WARN), (10, Action.HOLD), (180, Action.HOLD)],
)
def test_bpm_quota(invalid, action):
    valid = np.ones(180, dtype=bool)
    valid[np.arange(invalid) * 2 % 180 + np.arange(invalid) // 90] = False
    assert bpm_quota(valid, S).action is action


@pytest.mark.parametrize(("rms", "largest"), [(NAN, 0.0), (0.0, NAN)])
def test_a_distortion_that_is_not_a_number_trips(rms, largest):
    assert orbit_distortion(rms, largest, S).action is Action.TRIP


def test_masked_bpms_do_not_use_up_the_quota():
    counting = np.arange(20) >= 12
    valid = counting.copy()
    assert bpm_quota(valid, S, counting=counting).action is Action.OK
    valid[12] = False
    said = bpm_quota(valid, S, [f"B{i}" for i in range(20)], counting)
    assert (said.action, said.reason) == (Action.WARN, "1 of 8 BPMs are invalid: B12")
    assert bpm_quota(counting & False, S, counting=counting).action is Action.HOLD


def test_no_quota_allows_a_ring_without_bpms():
    assert bpm_quota(np.zeros(3, dtype=bool), S).action is Action.HOLD


def test_a_readback_follows_between_recent_setpoints_and_nan_does_not():
    recent = [np.array([2.0, 2.0, 2.0, 2.0]), np.array([1.0] * 4), np.array([0.0] * 4)]
    readback = np.array([0.5, 2.05, 2.2, NAN])
    assert not_following(readback, recent, S).tolist() == [False, False, True, True]
    tight = InterlockSettings(readback_lag=0)
    assert not_following(readback, recent, tight).tolist() == [True, False, True, True]
    off = InterlockSettings(readback_tolerance=None)
    assert not not_following(readback, recent, off).any()


def test_unknown_setpoints_are_not_followed():
    assert not_following(np.zeros(2), [np.full(2, NAN)], S).all()


def test_the_gravest_verdict_wins_and_the_first_among_equals():
    warn, trip = Verdict(Action.WARN, "a", "a"), Verdict(Action.TRIP, "b", "b")
    assert worst(FINE, warn, trip, Verdict(Action.TRIP, "c", "c")) is trip
    assert worst() is FINE


def test_names_are_cut_short():
    assert name_some(np.array([True, True, False, True]), "abcd", 2) == "a, b and 1 more"
    assert name_some(np.array([False, True]), ()) == "#1"
