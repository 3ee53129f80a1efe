"""Setpoints that a crate now and then does not get."""

import pytest

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.random_values import state
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.diagnose.strike_scan import latent_candidates
from orbitfb.effects.build import build, layout_of
from orbitfb.effects.registry import effect
from orbitfb.effects.settings import parse_effect
from orbitfb.physics.places import Ring

RING = Ring.load()
LAYOUT = layout_of(RING, "x", 0.1)
NAMES = LAYOUT.correctors.names


@pytest.mark.parametrize(
    ("places", "columns"),
    [
        (f",names={'+'.join(NAMES[8:13])}", tuple(range(8, 13))),
        (f",names={NAMES[40]}", (40,)),
        ("", ()),
    ],
)
def test_who_loses_writes_is_found_and_how_many(places, columns):
    effects = build([parse_effect(f"missed-write:probability=0.05{places}")], LAYOUT, 1)
    bench = Bench(simulate_record(RING, "x", 900, 5, effects, dither=2e-3, period=0.1))
    best = max(latent_candidates(bench, effect("missed-write")), key=lambda one: one.gain)
    assert best.cause.places == columns
    low, high = state(bench, best.cause).intervals["probability"]
    assert low < 0.05 < high


def test_a_quiet_record_loses_none():
    bench = Bench(simulate_record(RING, "x", 900, 5, dither=2e-3, period=0.1))
    assert all(one.gain < 10.0 for one in latent_candidates(bench, effect("missed-write")))
