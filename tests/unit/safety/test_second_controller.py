"""Somebody else who moves the correctors tick after tick is a second controller."""

import numpy as np
import pytest

from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.second_controller import SecondController
from orbitfb.safety.verdict import Action

M = 20
MINE = np.ones(M, dtype=bool)
ALL = np.ones(M, dtype=bool)
SETTINGS = InterlockSettings(second_controller_ticks=5, max_lost_correctors=3)
STAYS, YIELDS = (lambda: 0.99), (lambda: 0.0)


def some(count):
    mask = np.zeros(M, dtype=bool)
    mask[:count] = True
    return mask


def actions(masks, closed=True, draw=YIELDS, mine=MINE, settings=SETTINGS):
    second, verdicts = SecondController(), []
    for mask in masks:
        verdict, second = second.look(mask, mine, settings, (), closed, draw)
        verdicts.append(verdict)
    return [verdict.action for verdict in verdicts], verdicts[-1].reason


def test_a_closed_loop_trips_once_it_is_sure_and_names_what_is_moved():
    said, reason = actions([ALL] * 5)
    assert said == [Action.OK] * 4 + [Action.TRIP]
    assert reason.startswith(
        "somebody else moves 20 of 20 setpoints tick by tick, as a second controller does: #0, #1,"
    )


def test_it_gives_way_by_lot():
    assert actions([ALL] * 50, draw=STAYS)[0][4:] == [Action.WARN] * 46


def test_of_two_that_see_each_other_one_gives_way_as_a_rule():
    random = np.random.default_rng(5)
    both = 0
    for _ in range(400):
        tripped = [False, False]
        while not any(tripped):
            tripped = [2 * SETTINGS.second_controller_ticks * random.random() < 1 for _ in "ab"]
        both += all(tripped)
    assert both / 400 < 0.1


def test_every_other_orbit_suffices_and_a_hand_does_not():
    assert actions([ALL, ALL, None] * 20, draw=STAYS)[0][-3:-1] == [Action.WARN] * 2
    assert set(actions([ALL] * 4 + [None] * 8)[0]) == {Action.OK}
    assert set(actions([some(3)] * 50)[0]) == {Action.OK}
    assert actions([some(4)] * 5)[0][-1] is Action.TRIP


def test_it_is_about_correctors_that_the_loop_moves():
    assert set(actions([some(8)] * 20, mine=~some(8))[0]) == {Action.OK}


def test_of_a_few_correctors_half_are_single_ones():
    two = np.arange(M) < 2
    assert set(actions([some(1)] * 20, mine=two)[0]) == {Action.OK}
    assert actions([some(2)] * 20, mine=two)[0][-1] is Action.TRIP


def test_a_loop_that_waits_does_not_close_beside_it():
    said, _ = actions([ALL] * 5, closed=False, draw=STAYS)
    assert said == [Action.HOLD] * 4 + [Action.TRIP]
    said, _ = actions([ALL, None, None], closed=False)
    assert said == [Action.HOLD, Action.HOLD, Action.OK]


@pytest.mark.parametrize("closed", [True, False])
def test_who_looks_never_sees_nobody(closed):
    never = InterlockSettings(second_controller_ticks=0)
    assert set(actions([ALL] * 50, closed, settings=never)[0]) == {Action.OK}
