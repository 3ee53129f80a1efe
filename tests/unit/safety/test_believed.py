"""Which ticks may teach: those before a sign of an answer, never those without one."""

import numpy as np

from orbitfb.safety.answers.expectation import Owed
from orbitfb.safety.answers.owing import Answering, Session
from orbitfb.safety.believed import KEPT, Believed

OWED, ASKS = Owed.nothing(2, 2), Session.begin(2, 2)


def follow(believed, ticks, **answering):
    for tick in ticks:
        believed = believed.follow(tick, Answering(**answering))
    return believed


def teaching(believed, ticks=40):
    return np.flatnonzero(believed.teaches(np.arange(ticks))).tolist()


def closed_at_10():
    return follow(follow(Believed(), range(10)), range(10, 20), owed=OWED, since=1.0)


def test_an_open_loop_asks_for_nothing_and_its_ticks_teach():
    assert teaching(follow(Believed(), range(10))) == list(range(9))


def test_ticks_of_a_closed_loop_wait_for_a_sign_of_an_answer():
    assert max(teaching(closed_at_10())) == 9
    assert max(teaching(follow(closed_at_10(), range(20, 25), owed=OWED, since=1.0))) == 9


def test_a_sign_vouches_for_the_ticks_before_it_was_gathered():
    asked = follow(closed_at_10(), range(20, 25), owed=OWED, since=1.0, session=ASKS)
    once = follow(asked, [25], owed=OWED, since=2.5, session=ASKS)
    assert teaching(once) == list(range(20))  # what failed at 22 might still have shown a sign
    twice = follow(once, [26, 27], owed=OWED, since=2.7, session=ASKS)
    assert teaching(twice) == list(range(25))


def test_ticks_that_wait_when_the_ring_is_found_not_to_answer_never_teach():
    asked = follow(closed_at_10(), range(20, 25), owed=OWED, since=1.0, session=ASKS)
    tripped = follow(asked, [25], owed=OWED, since=1.0, found=1)
    after = follow(follow(tripped, range(26, 30), found=1), range(30, 40), since=3.0, found=1)
    assert after.count == 26 - 10
    assert teaching(after) == [*range(10), *range(26, 39)]


def test_a_device_that_is_found_takes_back_what_was_believed_since_nobody_was_in_doubt():
    asked = follow(closed_at_10(), range(20, 25), owed=OWED, since=1.0, session=ASKS)
    answered = follow(asked, range(25, 30), owed=OWED, since=2.5, session=ASKS)
    answered = follow(answered, range(30, 32), owed=OWED, since=3.0, session=ASKS)
    assert max(teaching(answered)) == 24
    found = follow(answered, [32], owed=OWED, since=3.0, session=ASKS, found=1)
    assert max(teaching(found)) == 9


def test_ticks_that_wait_when_the_loop_opens_never_teach():
    opened = follow(closed_at_10(), range(20, 30))
    assert teaching(opened) == [*range(10), *range(20, 29)]
    assert opened.count == 10


def test_without_the_check_all_ticks_teach():
    assert teaching(follow(Believed(), range(30), owed=None, found=0)) == list(range(29))


def test_only_the_last_stretches_are_remembered():
    believed = Believed()
    for begin in range(0, 20 * KEPT * 2, 20):
        believed = follow(believed, range(begin, begin + 10))
        believed = follow(believed, range(begin + 10, begin + 20), owed=OWED, since=1.0)
    assert len(believed.refused) == KEPT


def test_ticks_at_which_the_loop_asks_are_counted():
    asked = follow(closed_at_10(), range(20, 25), owed=OWED, since=1.0, session=ASKS)
    assert (closed_at_10().asked, asked.asked) == (0, 5)
    assert follow(asked, [25], owed=OWED, since=2.5).asked == 5
