"""What somebody may have meant."""

import pytest

from orbitfb.core.near_names import did_you_mean, near_names
from orbitfb.physics.places import Ring


@pytest.mark.parametrize("name", ["CH1A_C99", "PM1A_C9", "ch2a_c10", "PL1B_C30"])
def test_a_device_with_a_wrong_end_is_answered_with_its_own_family(name):
    ring = Ring.load()
    known = ring.names("COR") if name[:2].upper() == "CH" else ring.names("BPM")
    near = near_names(name, known)
    assert near
    assert all(each[:2] == name[:2].upper() for each in near)


def test_letters_that_are_wrong_left_out_or_exchanged():
    known = ("corrector-gain", "corrector-lag", "bpm-gain", "loop-delay")
    for typed in ("corector-gain", "corrector-gian", "Corrector-Gain", "correctorgain"):
        assert near_names(typed, known)[0] == "corrector-gain"


def test_a_part_of_a_name_offers_those_that_contain_it():
    known = ("corrector-quantisation", "corrector-lag", "bpm-gain")
    assert near_names("corrector", known) == ["corrector-lag", "corrector-quantisation"]
    assert near_names("gain", known) == ["bpm-gain"]


def test_what_is_like_nothing_gets_no_hint():
    assert did_you_mean("zzz", ("open", "close")) == ""
    assert did_you_mean("", ("open", "close")) == ""


def test_the_hint_is_a_question_that_follows_the_name():
    assert did_you_mean("clsoe", ("open", "close")) == " (did you mean close?)"
    assert did_you_mean("gain", ("gain-x", "gain-y")) == " (did you mean gain-x or gain-y?)"
    assert did_you_mean("abcd", ("abc1", "abc2", "abc3")) == " (did you mean abc1, abc2 or abc3?)"
