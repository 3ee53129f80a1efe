"""Fixtures of the tests of the post-mortems."""

import pytest
from postmortem_loop import Loop


@pytest.fixture
def loop(tmp_path):
    """A closed loop with a recorder; it is stopped at the end."""
    made = Loop(tmp_path / "postmortem")
    yield made
    made.settle()


@pytest.fixture
def tripped(loop):
    """A loop that lost its beam at tick 60, and its file."""
    loop.ticks(60)
    loop.ticks(30, "beam_lost")
    loop.settle()
    [path] = loop.files()
    return loop, path
