"""A cause acts as its law says, or something else at its devices shows through."""

import numpy as np
import pytest

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.departure import Departure, departure
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fit import fit
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.actuating import ColumnsEffect
from orbitfb.effects.build import build, layout_of
from orbitfb.effects.registry import all_effects
from orbitfb.effects.settings import parse_effect
from orbitfb.physics.places import Ring

RING = Ring.load()
LAYOUT = layout_of(RING, "x", 0.1)
COLUMN = LAYOUT.correctors.names.index("CL1A_C05")


class OvershootsUpwards(ColumnsEffect):
    """A law of no library: upward steps are too large, downward ones are right."""

    def __init__(self, places, size):
        super().__init__(places)
        self._size, self._last = size, None

    def follow(self, wanted):
        last = wanted if self._last is None else self._last
        self._last = wanted.copy()
        return wanted + self._size * np.maximum(wanted - last, 0.0)


def departs(*effects) -> tuple[Departure, float]:
    """Departure of the best gain of the corrector, and that gain."""
    record = simulate_record(RING, "x", 700, 5, effects, dither=2e-3, period=LAYOUT.period)
    kind = all_effects()["corrector-gain"]
    found = fit(Bench(record), (Cause(kind, (COLUMN,), {"gain": 0.1}),))
    bench = Bench(record, found.causes)
    return departure(bench, found.causes[0], found.gain), found.gain


def test_a_cause_of_the_library_does_not_depart_from_its_law():
    told = build([parse_effect("corrector-gain:gain=0.3,names=CL1A_C05")], LAYOUT, 1)
    its, gain = departs(*told)
    assert gain > 100.0
    assert its.nats < 0.05 * gain
    assert its.chance > 0.9 and not its.stand_in


def test_the_nearest_effect_of_another_law_is_told_from_it():
    its, gain = departs(OvershootsUpwards(np.array([COLUMN]), 0.6))
    assert "change" in its.course
    assert its.nats > 0.1 * gain
    assert its.chance < 0.01


@pytest.mark.parametrize(
    ("nats", "gain", "chance", "stand_in"),
    [(0.0, 50.0, 1.0, False), (5.0, 50.0, 0.5, False), (40.0, 50.0, 0.0, True)],
)
def test_a_tenth_of_the_gain_is_left_to_nature(nats, gain, chance, stand_in):
    its = Departure("somehow", nats, gain)
    assert its.chance == pytest.approx(chance, abs=1e-6)
    assert its.stand_in is stand_in
