"""Channels that are away are searched for anew, but no faster than their server answers."""

import numpy as np
import pytest

from orbitfb.epics.reconnecting import LONGEST, Keeper


class Group:
    """Channels; each search has its answers some looks later, unless there was another one."""

    def __init__(self, size, after):
        self.connected, self.losses, self.searches = np.zeros(size, dtype=bool), 0, []
        self.after, self.now = after, 0.0

    @property
    def all_connected(self):
        return bool(self.connected.all())

    def reopen_away(self):
        self.searches.append(self.now)

    def go_on(self, seconds, at_once):
        """Let answers come to the last search: some of them at a time."""
        self.now += seconds
        since = self.searches[-1] if self.searches else 0.0
        if self.now - since >= self.after:
            away = np.flatnonzero(~self.connected)[:at_once]
            self.connected[away] = True


def run(group, period, seconds, at_once=1000):
    looks = []
    keeper = Keeper(None, (group,), period, lambda: looks.append(group.now))
    wait = period
    while group.now < seconds:
        group.go_on(wait, at_once)
        wait = keeper.look()
    return looks


@pytest.mark.parametrize("period", [0.5, 2.0])
@pytest.mark.parametrize("after", [0.1, 1.5, 3.5])
def test_a_server_that_answers_late_is_not_asked_again_before_it_can(period, after):
    group = Group(500, after)
    run(group, period, 30.0)
    assert group.all_connected


def test_what_is_coming_is_not_searched_for_anew():
    group = Group(500, 0.1)
    run(group, 0.5, 10.0, at_once=40)
    assert group.searches == [] and group.all_connected


def test_a_server_that_is_away_is_searched_for_all_the_time():
    group = Group(5, 1e9)
    looks = run(group, 0.5, 100.0)
    assert np.diff(group.searches).max() <= LONGEST and len(looks) == len(group.searches)
    slow = Group(5, 1e9)
    run(slow, 10.0, 100.0)
    assert np.diff(slow.searches).max() == 10.0


def test_once_all_are_there_it_looks_as_often_as_before():
    group = Group(5, 3.0)
    keeper = Keeper(None, (group,), 0.5, lambda: None)
    for _ in range(5):
        keeper.look()
    group.connected[:] = True
    assert keeper.look() == 0.5
    group.connected[2] = False
    group.losses += 1
    group.now = 1.0
    keeper.look()
    assert group.searches[-1] == 1.0
