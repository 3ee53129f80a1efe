"""When a further cause is believed beside the ones before it."""

from types import SimpleNamespace

import pytest

from orbitfb.diagnose import rounds
from orbitfb.effects.registry import all_effects

DRIFT, DELAY, LEVEL = (all_effects()[name] for name in ("bpm-drift", "loop-delay", "noise-level"))


def entry(kind, weight, inflation=1.0):
    return SimpleNamespace(
        kind=kind,
        weight=weight,
        gain=weight,
        held_out=weight,
        cause=None,
        fit=SimpleNamespace(inflation=inflation),
    )


def round_of(best, accepted=None):
    return SimpleNamespace(
        entries=(best,), bench=None, accepted=accepted, probabilities=lambda: {best.kind.id: 1.0}
    )


@pytest.mark.parametrize(
    ("weight", "inflation", "lacks", "believed"),
    [
        (800.0, 1.0, "slowly", True),
        (100.0, 1.0, "slowly", False),
        (100.0, 1.0, "", True),
        (100.0, 2.0, "", False),
        (20.0, 1.0, "", False),
    ],
)
def test_a_further_cause_is_worth_less_beside_one_that_keeps_its_law(
    monkeypatch, weight, inflation, lacks, believed
):
    monkeypatch.setattr(rounds, "departure", lambda *_: SimpleNamespace(course=lacks))
    first = entry(DELAY, 10000.0)
    best = entry(DRIFT, weight, inflation)
    found = rounds.winner(round_of(best), [round_of(first, first)])
    assert (found is best) is believed


def test_noise_has_no_law_to_keep():
    first, best = entry(LEVEL, 10000.0), entry(DRIFT, 100.0)
    assert rounds.winner(round_of(best), [round_of(first, first)]) is None


@pytest.mark.parametrize(("worth", "believed"), [(0.0, True), (1000.0, True), (1e5, False)])
def test_beside_what_the_screen_is_certain_of_it_must_be_worth_a_share_too(worth, believed):
    best = entry(DRIFT, 100.0)
    assert (rounds.winner(round_of(best), [], worth) is best) is believed


@pytest.mark.parametrize(("weight", "believed"), [(9.0, False), (40.0, True)])
def test_beside_what_was_taken_out_of_the_record_it_must_be_sure(weight, believed):
    best = entry(DRIFT, weight)
    alone = round_of(best)
    assert rounds.winner(alone, []) is best
    assert (rounds.winner(alone, [], beside=True) is best) is believed


def test_what_a_cause_has_to_be_worth_is_what_makes_it_likely():
    """The least weight is that at which one kind of so many has a probability of 0.9."""
    needed = rounds.least_weight(45, further=False)
    one = rounds.Round(None, (entry(DRIFT, needed),), 45, None)
    assert one.probabilities()[DRIFT.id] == pytest.approx(0.9)
    assert rounds.least_weight(45, further=True) > needed
