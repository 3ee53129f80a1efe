"""Noise that remembers, from some row on, told from a BPM that is slow."""

import numpy as np
import pytest

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.entry import enter
from orbitfb.diagnose.randomness import noise_candidates
from orbitfb.diagnose.scan import Scanner
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.build import build, layout_of
from orbitfb.effects.registry import effect
from orbitfb.effects.settings import parse_effect
from orbitfb.physics.places import Ring

RING = Ring.load()
LAYOUT = layout_of(RING, "x", 0.1)
RACK = LAYOUT.bpms.names[27:31]
"""The end of one cell and the beginning of the next."""


@pytest.fixture(scope="module")
def bench() -> Bench:
    told = f"noise-coloured:correlation=0.85,names={'+'.join(RACK)},from=50s"
    effects = build([parse_effect(told)], LAYOUT, 1)
    return Bench(simulate_record(RING, "x", 1000, 4, effects, period=0.1))


def test_a_rack_whose_noise_begins_to_remember_is_found_with_its_row(bench: Bench) -> None:
    best = max(
        (enter(bench, one) for one in noise_candidates(bench, effect("noise-coloured"))),
        key=lambda entry: entry.weight,
    )
    assert best.cause.places == (27, 28, 29, 30)
    assert abs(best.cause.onset - 300) <= 3  # the record begins after 20 s
    # −½ log(1 − ρ²) of every reading, less what drift and healthy noise may have of it.
    most = -0.5 * np.log(1.0 - 0.85**2) * 4 * 700
    assert 0.4 * most < best.gain < 1.1 * most


def test_it_is_no_slow_bpm(bench: Bench) -> None:
    slow = [enter(bench, one) for one in Scanner(bench).candidates(effect("bpm-lowpass"))]
    coloured = [enter(bench, one) for one in noise_candidates(bench, effect("noise-coloured"))]
    least = max(one.weight for one in coloured) - 20.0
    assert all(one.weight < least for one in slow)
