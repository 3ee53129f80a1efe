"""What the end of a record shows competes for the whole of it."""

from types import SimpleNamespace

from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.search import Outcome
from orbitfb.effects.registry import all_effects


def winner(name, onset=0, fit="fitted", **values):
    kind = all_effects()[name]
    cause = Cause(kind, (4,), {p.name: p.typical for p in kind.parameters} | values, onset)
    entry = SimpleNamespace(
        kind=kind, cause=cause, fit=fit, candidate=Candidate(cause, 30.0, 180.0)
    )
    return SimpleNamespace(accepted=entry)


def late(*rounds):
    return Outcome(rounds, None, None).late(1130, 2000)  # type: ignore[arg-type]


def test_what_acts_in_the_whole_end_begins_with_it_and_pays_for_its_row():
    (found,) = late(winner("corrector-saturation", limit=0.027))
    assert (found.cause.onset, found.cause.values["limit"]) == (1130, 0.027)
    assert found.choices == 180.0 * 2000


def test_what_begins_in_the_end_has_paid_for_its_row():
    (found,) = late(winner("bpm-gain", onset=70, gain=0.1))
    assert found.cause.onset == 1200
    assert found.choices == 180.0


def test_what_grows_or_has_no_course_in_time_is_looked_for_anew():
    assert late(winner("bpm-drift"), winner("noise-level", fit=None)) == []
    assert late(SimpleNamespace(accepted=None)) == []
