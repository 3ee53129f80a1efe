"""A cause that another one has made void is no cause."""

import pytest

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.budget import Budget
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.entry import enter
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.rounds import Round
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.diagnose.together import looked_at_again, without_void
from orbitfb.diagnose.tournament import tournament
from orbitfb.effects.build import build, layout_of
from orbitfb.effects.registry import effect
from orbitfb.effects.settings import parse_effect
from orbitfb.physics.places import Ring

RING = Ring.load()
LAYOUT = layout_of(RING, "x", 0.1)
KIND = effect("corrector-gain")


@pytest.fixture(scope="module")
def bench():
    """Two wrong gains."""
    texts = [f"corrector-gain:gain=0.3,names={LAYOUT.correctors.names[i]}" for i in (40, 90)]
    effects = build([parse_effect(text) for text in texts], LAYOUT, 1)
    return Bench(simulate_record(RING, "x", 500, 5, effects, dither=1e-3, period=0.1))


def rounds_of(bench, *places):
    """A round for every place, whose winner is a wrong gain there."""
    entries = [
        enter(bench, Candidate(Cause(KIND, (place,), {"gain": 0.1}), 50.0, 180.0))
        for place in places
    ]
    return [Round(bench, (entry,), 40, entry) for entry in entries]


def test_what_stood_in_for_a_later_cause_is_dropped(bench):
    rounds = rounds_of(bench, 41, 40, 90)
    kept, joint, causes = without_void(bench, bench, rounds)
    assert [one.accepted is not None for one in kept] == [False, True, True]
    assert [cause.places for cause in causes] == [(40,), (90,)]
    assert joint is not None and joint.causes == causes


def test_what_was_found_first_competes_again_beside_what_was_found_later(bench):
    rounds = rounds_of(bench, 41, 90)
    moving = tuple(one.accepted.cause for one in rounds)
    asked = []

    def beside(others, also):
        asked.append((others, also))
        own = Bench(bench.record, others)
        return Round(own, tuple(tournament(own, [KIND], also=also)), 1, None)

    found = looked_at_again(rounds, moving, beside, Budget())
    assert [one.accepted.cause.places for one in found] == [(40,), (90,)]
    ((others, also),) = asked
    assert others == (moving[1],)
    assert [one.cause.places for one in also] == [(41,)]
    late = Budget(-1.0)
    assert looked_at_again(rounds, moving, beside, late) == rounds
    assert "not judged again" in late.told([])
