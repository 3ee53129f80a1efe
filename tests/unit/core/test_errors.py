"""What errors say."""

import pickle

import numpy as np
import pytest

from orbitfb.core.errors import (
    MOST_SHOWN,
    AwayError,
    CampaignError,
    ConnectError,
    OrbitFeedbackError,
    RingError,
    few,
)


def test_many_names_are_shown_in_part_and_counted():
    names = [f"PV{number}" for number in range(542)]
    error = ConnectError(names, 600, 2.0, "Look there.")
    first, *shown, rest, advice = str(error).splitlines()
    assert first == "542 of 600 PVs did not connect within 2.0 s:"
    assert [name.strip() for name in shown] == names[:MOST_SHOWN]
    assert rest.strip() == f"… and {542 - MOST_SHOWN} more"
    assert advice == "Look there."
    assert error.missing == tuple(names)


def test_few_names_are_shown_all():
    names = [f"PV{number}" for number in range(MOST_SHOWN)]
    assert few(names).split() == names


@pytest.mark.parametrize(
    "error",
    [
        RingError("no ring"),
        ConnectError(["A", "B"], 3, 2.0, "Look there."),
        AwayError("one is away", np.zeros(2), np.array([True, False])),
        CampaignError([("task", "went wrong", "")], [None, {"kept": 1}]),
    ],
    ids=lambda error: type(error).__name__,
)
def test_what_a_worker_process_raises_arrives_as_it_was(error: OrbitFeedbackError) -> None:
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert again.__dict__.keys() == error.__dict__.keys()
