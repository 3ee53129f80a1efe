"""A change that does not show is waited for, where readbacks can tell and it is rare."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orbitfb.safety.arrival import RARE, Sent, acted, arrived

M = 60
RANDOM = np.random.default_rng(3)
BEFORE, CHANGE = RANDOM.normal(0.0, 0.3, M), RANDOM.normal(0.0, 0.01, M)
ALL = np.ones(M, dtype=bool)


def look(part, noise=0.0, late=0.0, counts=ALL, change=CHANGE):
    readback = BEFORE + part * change + noise * np.random.default_rng(5).normal(0.0, 1.0, M)
    return arrived(readback, BEFORE + change, counts, Sent(change, late))


@pytest.mark.parametrize(("part", "waits"), [(0.0, True), (0.3, True), (0.6, False), (1.0, False)])
def test_what_shows_is_told_and_waited_for_if_it_is_little(part, waits):
    seen, after = look(part)
    assert seen == (pytest.approx(part) if waits else None)
    assert (after.change is None) == (not waits)


def test_readbacks_that_say_nothing_hold_nobody_back():
    assert look(0.0, noise=0.001)[0] == pytest.approx(0.0, abs=0.05)
    assert look(0.0, noise=0.05) == (None, Sent(CHANGE, 0.0))  # nor is it learnt from
    assert look(np.nan)[0] is None
    assert look(0.0, change=np.zeros(M))[0] is None
    assert look(0.0, counts=~ALL)[0] is None


def test_correctors_that_are_left_out_or_not_known_do_not_count():
    stuck = np.arange(M) < 20
    readback = np.where(stuck, np.nan, BEFORE)
    change = np.where(np.arange(M) == 59, 10.0, CHANGE)
    assert arrived(readback, BEFORE + change, ALL, Sent(change, 0.0))[0] == pytest.approx(0.0)
    readback = np.where(np.arange(M) == 59, BEFORE, BEFORE + change)
    part = arrived(readback, BEFORE + change, np.arange(M) != 59, Sent(change, 0.0))[0]
    assert part is None


def test_a_machine_whose_readbacks_are_always_late_is_never_waited_for():
    sent = Sent()
    for _ in range(200):
        part, sent = arrived(BEFORE, BEFORE + CHANGE, ALL, Sent(CHANGE, sent.late))
        assert part is None
    assert sent.late > 0.9


def test_one_that_was_in_time_goes_on_being_waited_for_however_often_it_is_late():
    sent = Sent()
    for _ in range(100):
        _, sent = arrived(BEFORE + CHANGE, BEFORE + CHANGE, ALL, replace(sent, change=CHANGE))
    assert sent.prompt
    for _ in range(100):
        part, sent = arrived(BEFORE, BEFORE + CHANGE, ALL, replace(sent, change=CHANGE, waited=0))
        assert part is not None
    assert sent.late > RARE


@pytest.mark.parametrize("part", [0.0, 0.4, 1.0])
def test_the_orbit_tells_whether_a_large_change_has_acted(part):
    random = np.random.default_rng(8)
    predicted, noise = random.normal(0.0, 5e-6, M), random.normal(0.0, 0.3e-6, M)
    assert acted(part * predicted + noise, predicted, 2e-6) == pytest.approx(part, abs=0.05)
    step = np.where(np.arange(M) < 5, np.nan, part * predicted)
    assert acted(step, predicted, 2e-6) == pytest.approx(part)
    assert acted(part * predicted, predicted, 20e-6) is None
    assert acted(part * predicted + 50.0 * noise, predicted, 1e-9) is None
    assert acted(np.full(M, np.nan), predicted, 2e-6) is None


def test_a_change_that_is_waited_for_counts_once():
    sent = Sent(CHANGE, 0.0)
    for number in range(1, 10):
        part, sent = arrived(BEFORE, BEFORE + CHANGE, ALL, sent)
        assert (part, sent.waited) == (pytest.approx(0.0), number) and sent.late < 0.1
    part, after = arrived(BEFORE + CHANGE, BEFORE + CHANGE, ALL, sent)
    assert (part, after) == (None, Sent(None, sent.late))


@given(st.lists(st.booleans(), max_size=200))
def test_no_more_than_a_share_is_ever_held_back_at_one_that_never_was_in_time(shows):
    sent, waits = Sent(), 0
    for shown in shows:
        before = replace(sent, change=CHANGE, waited=0, prompt=False)
        part, sent = arrived(BEFORE + shown * CHANGE, BEFORE + CHANGE, ALL, before)
        waits += part is not None
        assert 0.0 <= sent.late <= 1.0 and not (shown and part is not None)
    assert waits <= 10 + 2 * RARE * len(shows)
