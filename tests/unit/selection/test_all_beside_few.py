"""Errors of all devices beside a few that are far more at fault."""

import numpy as np
import pytest

from benchmarks.small_ring import small_ring
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.beside import enough_beside
from orbitfb.diagnose.selection.rounds import tournament
from orbitfb.effects.build import layout_of
from orbitfb.physics.response import response
from tests.unit.hypotheses.small_records import NOISE, kinds_for, recorded


@pytest.mark.parametrize(("scatter", "second"), [(1e-3, True), (1e-4, False)])
def test_gradients_of_all_are_told_beside_correctors_that_act_late(
    scatter: float, second: bool
) -> None:
    """They have a thousandth of the evidence, which a law that is a little wrong might leave."""
    ring, rng = small_ring(), np.random.default_rng(41)
    layout, rows, late = layout_of(ring, "x", 0.1), 900, [3, 4]
    errors = scatter * rng.standard_normal(len(ring.places("QUAD")))
    setpoints = (0.002 * rng.standard_normal((rows, layout.response.shape[1]))).cumsum(axis=0)
    setpoints[:, late] = (0.003 * rng.standard_normal((rows, 2))).cumsum(axis=0)
    currents = setpoints.copy()
    currents[1:, late] = setpoints[:-1, late]
    orbit = currents @ response(ring, "x", errors).T
    walk = (2e-9 * rng.standard_normal((rows, len(errors)))).cumsum(axis=0)
    orbit += walk @ layout.orbit_per_kick("QUAD", "x").T
    record = recorded(layout, setpoints, orbit + NOISE * rng.standard_normal(orbit.shape))
    kinds = kinds_for(record)
    found, rounds = tournament(Workspace.of(record, kinds), kinds)
    wanted = [("loop-delay", (3, 4))] + [("quadrupole-gradient", ())] * second
    assert [(one.kind.id, tuple(sorted(one.places))) for one in found] == wanted
    if second:
        assert found[1].evidence < enough_beside(found[0].evidence, rounds[1].space)
