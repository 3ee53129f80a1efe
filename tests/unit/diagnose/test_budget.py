"""When its time is over a search gives what it has, and says what it left out."""

import inspect
from dataclasses import replace

import pytest

from orbitfb.cli.diagnosis.diagnose import diagnose_record
from orbitfb.diagnose.budget import SEARCH_SECONDS, Budget
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.search import Outcome, search
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.build import build, layout_of
from orbitfb.effects.registry import effect
from orbitfb.effects.settings import parse_effect
from orbitfb.physics.places import Ring
from orbitfb.records.record import Record

RING = Ring.load()
LAYOUT = layout_of(RING, "x", 0.1)


class Clock:
    """Time that passes by one second with every look at it, from some look on."""

    def __init__(self, stands: int) -> None:
        self.looks, self.stands = 0, stands

    def __call__(self) -> float:
        self.looks += 1
        return float(max(self.looks - self.stands, 0))


@pytest.fixture(scope="module")
def record() -> Record:
    """One wrong corrector."""
    there = build([parse_effect("corrector-gain:gain=0.3,names=CL1A_C05")], LAYOUT, 1)
    return simulate_record(RING, "x", 250, 1, there, dither=2e-3, period=LAYOUT.period)


KINDS = [effect("corrector-gain"), effect("corrector-lag"), effect("bpm-gain")]


@pytest.fixture(scope="module")
def whole(record) -> Outcome:
    """Of a search that had all the time that it wanted."""
    return search(record, KINDS, budget=Budget(1.0, Clock(10**9)))


def test_nothing_is_left_out_in_time(whole):
    assert whole.cut == ""
    assert [one.kind.id for r in whole.winners if (one := r.accepted)] == ["corrector-gain"]


def test_effects_that_were_not_reached_are_told(record):
    budget = Budget(2.0, Clock(2))
    found = search(record, KINDS, budget=budget)
    assert "bpm-gain" in budget.unseen
    assert "corrector-gain" not in budget.unseen
    assert "bpm-gain" in found.cut
    assert "2 s" in found.cut


def test_what_was_not_fitted_lowers_the_probability_of_what_was(whole):
    first = whole.rounds[0]
    values = {"gain": 0.1}
    missed = Candidate(Cause(effect("bpm-gain"), (3,), values), first.entries[0].weight + 3.0, 1.0)
    chances = replace(first, untried=(missed,)).probabilities()
    assert first.probabilities()["corrector-gain"] > 0.9
    assert chances["corrector-gain"] < 0.1
    assert chances["bpm-gain"] > 0.9


def test_what_was_left_out_is_told_once():
    budget = Budget(7.0, Clock(0))
    budget.leave("the sea")
    budget.leave("the sea")
    told = budget.told(["bpm-gain"])
    assert told.count("the sea") == 1
    assert "7 s" in told and "bpm-gain" in told and "--search-seconds" in told


def test_the_command_has_the_time_of_the_library():
    default = inspect.signature(diagnose_record).parameters["search_seconds"].default
    assert default == SEARCH_SECONDS
