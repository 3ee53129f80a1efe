"""Candidates are compared by what they leave, not each by its own floor's nothing."""

import pytest

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.diagnose.tournament import tournament
from orbitfb.effects.build import build, layout_of
from orbitfb.effects.registry import effect
from orbitfb.effects.settings import parse_effect
from orbitfb.physics.places import Ring

RING = Ring.load()
LAYOUT = layout_of(RING, "x", 0.1)


@pytest.mark.parametrize("place", [3, 65])
def test_a_large_gain_error_is_no_leak_into_a_neighbour(place: int):
    text = f"corrector-gain:gain=0.5,names={LAYOUT.correctors.names[place]}"
    effects = build([parse_effect(text)], LAYOUT, 1)
    record = simulate_record(RING, "x", 200, 5, effects, dither=2e-3)
    kinds = [effect("corrector-crosstalk"), effect("corrector-gain")]
    first, *_ = tournament(Bench(record), kinds)
    assert (first.kind.id, first.cause.places) == ("corrector-gain", (place,))
