"""Places that are struck together because they are on one supply, or on none that the model has."""

import numpy as np
from test_scans import LAYOUT, RING

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.scan import Scanner
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.diagnose.tournament import tournament
from orbitfb.effects.build import build
from orbitfb.effects.registry import all_effects
from orbitfb.effects.settings import parse_effect


def test_sextupoles_do_nothing_to_a_vertical_orbit_alone():
    bench = Bench(simulate_record(RING, "y", 300, 3))
    assert bench.information(np.zeros_like(bench.orbit)) == 0.0
    assert Scanner(bench).candidates(all_effects()["sextupole"]) == []


def test_the_sextupoles_of_a_linear_model_show_when_the_golden_orbit_changes():
    mean = float(np.mean(np.abs(RING.strength("SEXT"))))
    effects = build([parse_effect(f"sextupole:strength={mean}")], LAYOUT, 1)
    record = simulate_record(
        RING, "x", 900, 3, effects, period=LAYOUT.period, steering=10, steering_rms=100e-6
    )
    kinds = [all_effects()[name] for name in ("sextupole", "quadrupole-gradient", "bpm-gain")]
    found, *_ = tournament(Bench(record), kinds)
    assert (found.kind.id, found.candidate.group) == ("sextupole", "all")
    assert len(found.cause.places) == len(RING.places("SEXT"))
    low, high = found.fit.interval(0)
    assert low < mean < high
