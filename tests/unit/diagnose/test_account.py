"""A name is taken back by later data only if its cause had something to say about them."""

from types import SimpleNamespace

import pytest

from orbitfb.diagnose.answer_blocks import AmbiguousSet, Audit, Unknown
from orbitfb.diagnose.answer_parts import Cause, Shrink
from orbitfb.diagnose.judgement import Judgement, _state, held_to_account
from orbitfb.diagnose.wording import headline
from orbitfb.effects.registry import effect


def outcome_of(name: str, weight: float = 50.0) -> SimpleNamespace:
    winner = SimpleNamespace(accepted=SimpleNamespace(kind=effect(name), weight=weight))
    return SimpleNamespace(rounds=(SimpleNamespace(entries=()),), bench=None, winners=(winner,))


@pytest.mark.parametrize(
    ("name", "weight", "nats", "high", "state", "resolved"),
    [
        ("bpm-gain", 50.0, 0.95, 0.99, "named", True),
        ("bpm-gain", 50.0, 0.3, 0.4, "named_plus_remainder", True),
        ("bpm-gain", 50.0, 0.02, 0.1, "unknown", True),
        ("bpm-gain", 50.0, 0.02, 0.1, "named", False),  # nothing is there to be explained
        ("bpm-gain", 50.0, -3.9, -0.8, "unknown", False),  # it makes a gap where there was none
        (
            "bpm-gain",
            50.0,
            3e-12,
            2e-11,
            "named",
            True,
        ),  # it began before and stays: nothing to explain
        ("bpm-drift", 50.0, -7.0, -5.0, "named_plus_remainder", True),  # it has settled since
        ("bpm-drift", 9.0, -7.0, -5.0, "unknown", True),  # hardly shown, and not gone on
    ],
)
def test_a_name_is_held_to_later_data(name, weight, nats, high, state, resolved, monkeypatch):
    monkeypatch.setattr("orbitfb.diagnose.judgement.unknown_of", lambda *parts: Unknown())
    judged = Judgement("named", Audit(), None, 1.0, (), None)  # type: ignore[arg-type]
    shrunk = Shrink(
        nats=nats,
        low=min(nats, 0.0),
        high=high,
        um=nats,
        held_out_ticks=1000,
        on="the later record",
        resolved=resolved,
    )
    found = held_to_account(judged, outcome_of(name, weight), shrunk)  # type: ignore[arg-type]
    assert found.state == state
    assert (found.unknown is None) == (state == "named")
    if found.unknown is not None:
        assert f"{name} explains the record itself, but not the later record" in found.unknown.text


@pytest.mark.parametrize(
    ("gain", "scatter", "state"),
    [
        (83.0, 3.1, "unknown"),  # much is there, and the best of the library is far from it
        (83.0, 1.0, "no_gap"),  # what tidy scores do not make sure is not there
        (30.0, 3.1, "no_gap"),  # the choice among all rows and places finds as much in noise
    ],
)
def test_what_has_only_stand_ins_is_no_quiet_record(gain, scatter, state):
    fit = SimpleNamespace(gain=gain, inflation=scatter)
    weight = gain / scatter - 28.0  # as the search has it: less the prices of values and choice
    entry = SimpleNamespace(fit=fit, weight=min(weight, 0.0), held_out=gain)
    outcome = SimpleNamespace(rounds=(SimpleNamespace(entries=(entry,), kinds=45),), winners=())
    certain = SimpleNamespace(causes=())
    told = _state(outcome, certain, (), remains=False, explained=1.0)  # type: ignore[arg-type]
    assert told == state


@pytest.mark.parametrize(
    ("sure", "rivals", "remains", "chance", "state"),
    [
        (True, (), False, 0.9, "named"),
        (True, ("another",), False, 0.9, "ambiguous"),
        (True, (), True, 0.9, "named_plus_remainder"),
        (True, (), True, 0.2, "named_plus_remainder"),  # its probability says the rest
        (True, (), True, 0.05, "unknown"),  # what acts by another law is not that effect
        (False, (), False, 0.9, "ambiguous"),  # with nothing at all
        (False, (), True, 0.9, "unknown"),
        (False, (), False, 0.05, "no_gap"),  # or by another law: then it is nothing
    ],
)
def test_a_name_needs_certainty(sure, rivals, remains, chance, state):
    fit = SimpleNamespace(gain=20.0, inflation=1.0)
    entry = SimpleNamespace(fit=fit, weight=7.0, held_out=19.0)
    first = SimpleNamespace(
        sure=sure, rivals=lambda: rivals, accepted=entry, entries=(entry,), kinds=45
    )
    outcome = SimpleNamespace(rounds=(first,), winners=(first,))
    departures = (SimpleNamespace(stand_in=False, chance=chance, nameless=chance < 0.1),)
    certain = SimpleNamespace(causes=())
    told = _state(outcome, certain, departures, remains=remains, explained=1.0)  # type: ignore[arg-type]
    assert told == state
    if departures[0].nameless:  # what the screen proves has a name, whatever is found besides
        certain.causes = ("bpm-stuck",)
        told = _state(outcome, certain, departures, remains=remains, explained=1.0)  # type: ignore[arg-type]
        assert told == ("named_plus_remainder" if sure or remains else "named")


def test_what_may_be_nothing_is_told_so():
    cause = Cause(
        effect="thermal-drift", stage="disturbance", places=("QM2B_C11",), probability=0.9
    )
    sets = (AmbiguousSet(effects=("thermal-drift", "no_gap")),)
    said = headline("ambiguous", causes=(cause,), ambiguous=sets)
    assert "thermal-drift or nothing at all" in said
    assert "The likeliest is thermal-drift on QM2B_C11, P = 0.9." in said
