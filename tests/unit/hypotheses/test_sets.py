"""Which devices a law strikes, from their pull and information."""

import numpy as np

from orbitfb.diagnose.hypotheses.sets import best_set
from orbitfb.estimation.evidence import given_size


def test_a_group_of_which_one_shows_anything_is_that_one() -> None:
    """Correctors whose currents stay below a limit say nothing of it."""
    pull, information = np.array([0.0, 90.0, 0.0, 0.0]), np.diag([0.0, 80.0, 0.0, 0.0])
    groups = {"A": np.array([0, 1]), "B": np.array([2, 3])}
    assert best_set(pull, information, groups, given_size)[1] == (1,)
    pull[0], information[[0, 2, 3], [0, 2, 3]] = 60.0, 70.0
    assert best_set(pull, information, groups, given_size)[1] == (0, 1)


def test_devices_that_hide_each_other_are_found() -> None:
    """Each of them alone is less likely than none, and a third one looks like both."""
    moves = 100.0 * np.array([[1.0, 0.3, 0.0], [-1.0, 0.3, 0.0], [0.0, 0.5, 0.1], [0.1, 0.0, 1.0]])
    information = moves @ moves.T
    pull = information @ np.array([1.0, 1.0, 0.0, 0.0])
    assert np.all(given_size(pull, np.diag(information))[:2] < 0.0)
    assert best_set(pull, information, {}, given_size)[1] == (0, 1)
