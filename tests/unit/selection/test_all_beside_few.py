"""Errors of all devices beside a few that are far more at fault."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.small_ring import small_ring
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.refit import Course
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.beside import enough_beside, is_another
from orbitfb.diagnose.selection.rounds import tournament
from orbitfb.effects.build import layout_of
from orbitfb.effects.registry import effect
from orbitfb.physics.response import response
from tests.unit.hypotheses.small_records import NOISE, kinds_for, make_record, recorded


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


@pytest.mark.parametrize(("devices", "another"), [(12, True), (1, False)])
def test_what_strikes_the_one_place_that_it_may_strike_leaves_no_others(
    devices: int, another: bool
) -> None:
    """An energy is of the ring: that it leaves nothing to others says nothing of it."""
    kind = effect("corrector-deadband")
    space = Workspace.of(make_record(41), [effect("bpm-gain")])
    law = kind.laws(space.signals)[0]
    law = replace(law, patterns=tuple(np.asarray(one[:, :devices]) for one in law.patterns))
    source = Course(law, (0,), {"width": 1e-9}, np.ones(1))
    told = Candidate(kind, (0,), ("C0 (x)",), {"width": 1e-9}, 117.0, sources=(source,))
    large = Candidate(effect("energy-drift"), (), (), {"step": 1e-6}, 1e6)
    assert told.evidence < enough_beside(large.evidence, space)
    assert is_another(told, [large], space) is another
