"""Intervals of values are as wide as the healthy errors beside them leave them."""

import numpy as np
import pytest

from orbitfb.diagnose.background import GAIN_RMS
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fit import fit
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.build import build, layout_of
from orbitfb.effects.registry import effect
from orbitfb.effects.settings import parse_effect
from orbitfb.physics.places import Ring

RING = Ring.load()
LAYOUT = layout_of(RING, "x", 0.1)
COLUMN = LAYOUT.correctors.names.index("CL1A_C05")


def test_a_value_is_known_as_well_as_all_healthy_errors_at_once_leave_it() -> None:
    pattern = np.linalg.lstsq(LAYOUT.response, LAYOUT.response[:, COLUMN], rcond=0.2)[0]
    levels = np.resize([1.0, -1.0, 2.0, -2.0], 300)[:, None]
    told = build([parse_effect("corrector-gain:gain=0.06,names=CL1A_C05")], LAYOUT, 1)
    bench = Bench(
        simulate_record(RING, "x", 300, 3, told, excitation=0.2 * levels * pattern, period=0.1)
    )
    found = fit(bench, (Cause(effect("corrector-gain"), (COLUMN,), {"gain": 0.1}),))

    def seen(orbit):
        return bench.floor.whiten(orbit, bench.record.starts).ravel()

    own = seen(np.outer(bench.currents[:, COLUMN], LAYOUT.response[:, COLUMN]))
    units = np.eye(len(bench.sizes))
    errors = np.array([seen(bench.background.orbit(unit)) for unit in units])
    known = errors @ errors.T + np.eye(len(errors))
    pull = errors @ own
    expected = 1.0 / (own @ own - pull @ np.linalg.solve(known, pull))
    assert found.covariance[0, 0] / found.inflation == pytest.approx(expected, rel=0.02)
    assert expected > 0.98 * GAIN_RMS**2
