"""A change that does not show is waited for, where readbacks can tell and it is rare."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orbitfb.safety.arrival import RARE, Sent, arrived

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


def test_nor_for_long_if_they_are_so_from_now_on():
    sent = Sent()
    for _ in range(100):
        _, sent = arrived(BEFORE + CHANGE, BEFORE + CHANGE, ALL, Sent(CHANGE, sent.late))
    waits = 0
    for _ in range(100):
        part, sent = arrived(BEFORE, BEFORE + CHANGE, ALL, Sent(CHANGE, sent.late))
        waits += part is not None
    assert 3 <= waits <= 6


def test_a_change_that_is_waited_for_counts_once():
    sent = Sent(CHANGE, 0.0)
    for number in range(1, 10):
        part, sent = arrived(BEFORE, BEFORE + CHANGE, ALL, sent)
        assert (part, sent.waited) == (pytest.approx(0.0), number) and sent.late < 0.1
    part, after = arrived(BEFORE + CHANGE, BEFORE + CHANGE, ALL, sent)
    assert (part, after) == (None, Sent(None, sent.late))


@given(st.lists(st.booleans(), max_size=200))
def test_no_more_than_a_share_is_ever_held_back_in_the_long_run(shows):
    sent, waits = Sent(), 0
    for shown in shows:
        part, sent = arrived(BEFORE + shown * CHANGE, BEFORE + CHANGE, ALL, Sent(CHANGE, sent.late))
        waits += part is not None
        assert 0.0 <= sent.late <= 1.0 and not (shown and part is not None)
    assert waits <= 10 + 2 * RARE * len(shows)
