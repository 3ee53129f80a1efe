"""A model of any kind gains nothing where nothing is left, and sees what no cause explains."""

import numpy as np
from gap_cases import GAIN, PLACE, bench

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.ceiling import ceiling
from orbitfb.diagnose.gap import UNEXPLAINED, gap
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.build import layout_of
from orbitfb.effects.registry import effect
from orbitfb.physics.places import Ring


def test_nothing_is_left_of_records_without_a_gap():
    for its in (bench(False), bench(True, ((PLACE, GAIN),))):
        assert not ceiling(its).resolved


def test_a_late_loop_that_nobody_named_is_seen():
    ring, kind = Ring.load(), effect("corrector-lag")
    late = kind.simulate(
        layout_of(ring, "x", 0.1), np.arange(180), {"tau": 0.05}, np.random.default_rng(0)
    )
    its = Bench(simulate_record(ring, ticks=400, seed=5, effects=[late], dither=2e-5))
    found = ceiling(its)
    assert found.resolved
    answer = gap(its, best=found.white)
    assert answer.resolved
    assert answer.um > 0.0
    assert answer.by_stage[UNEXPLAINED] > 0.99 * answer.nats_per_tick
