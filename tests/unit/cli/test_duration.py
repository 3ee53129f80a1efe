"""Commands that take their time say so at once, on a terminal."""

import io
import sys

import pytest

from orbitfb.cli.duration import tells_its_time


class Terminal(io.StringIO):
    def isatty(self):
        return True


@tells_its_time("counting")
def count(most, fails=False):
    """Count."""
    print(*range(most))
    if fails:
        raise ValueError


def test_on_a_terminal_it_says_what_begins_and_how_long_it_took(monkeypatch, capsys):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    count(3)
    begun, took = terminal.getvalue().splitlines()
    assert begun == "counting …" and took.startswith("counting took 0.")
    assert capsys.readouterr().out == "0 1 2\n"


def test_elsewhere_it_says_nothing(capsys):
    count(3)
    assert capsys.readouterr().err == ""


def test_what_fails_did_not_take_its_time(monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with pytest.raises(ValueError):
        count(3, fails=True)
    assert terminal.getvalue() == "counting …\n"
