"""Errors that act on one another: gradients kick by the orbit that others have made."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.core.signals import Vector
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.rounds import tournament
from orbitfb.effects.build import layout_of
from orbitfb.effects.laws import DeviceLaw, Signals
from orbitfb.effects.optics.gradients import gradient_scatters, nearest_bpms, response_with
from orbitfb.effects.registry import effect
from orbitfb.physics.places import Ring
from orbitfb.records.layout import ChannelPlane, Layout
from orbitfb.records.record import Record
from tests.unit.hypotheses.small_records import NOISE, kinds_for, recorded, some_devices

ROWS = 600


def make_record(layout: Layout, gradients: Vector, seed: int) -> Record:
    """A loop with dither on a ring with gradient errors, told exactly."""
    rng = np.random.default_rng(seed)
    true, model = response_with(layout, gradients), layout.response
    inverse = np.linalg.pinv(model, rcond=1e-2)
    scale = 20e-6 / np.sqrt(np.mean(model**2) * model.shape[1])
    kicks = (rng.standard_normal((ROWS, model.shape[1])) * 0.004 * scale).cumsum(axis=0)
    setpoints, readings = np.zeros((ROWS, model.shape[1])), np.zeros((ROWS, model.shape[0]))
    for row in range(ROWS):
        orbit = true @ (setpoints[row] + kicks[row])
        readings[row] = orbit + NOISE * rng.standard_normal(len(orbit))
        if row + 1 < ROWS:
            more = scale * rng.standard_normal(model.shape[1])
            setpoints[row + 1] = 0.9 * setpoints[row] - 0.3 * inverse @ readings[row] + more
    return recorded(layout, setpoints, readings)


def still(layout: Layout) -> Signals:
    """Ten rows in which nothing happens."""
    currents, readings = (np.zeros((10, count)) for count in layout.response.shape[::-1])
    return Signals(recorded(layout, currents, readings), currents, readings)


@pytest.mark.parametrize("plane", ["x", "y"])
def test_what_gradients_add_together_is_what_the_exact_response_has_more(
    plane: ChannelPlane,
) -> None:
    """Of errors five times as large as those of a healthy ring."""
    layout = layout_of(Ring.load(), plane, 0.1)
    errors = np.random.default_rng(4).standard_normal(300)
    gradients = 5.0 * gradient_scatters(layout) * errors

    change = effect("quadrupole-gradient").together(layout, [gradients, gradients])

    exact = response_with(layout, gradients) - response_with(layout, np.zeros(300))
    assert np.linalg.norm(exact) > 0.05 * np.linalg.norm(layout.response)
    assert change == pytest.approx(exact, rel=1e-9, abs=1e-9 * np.abs(exact).max())


def test_of_an_unknown_ring_they_kick_by_what_the_nearest_bpms_see() -> None:
    """Turn by turn of the same sum: kicks, the orbit that they make, the kicks by that."""
    layout = replace(some_devices(9), ring=None)
    kind = effect("quadrupole-gradient")
    near, scatter = nearest_bpms(layout), kind.healthy_scatter(layout)
    assert scatter is not None
    sizes = 2.0 * scatter * np.random.default_rng(5).standard_normal(len(scatter))
    (law,) = [one for one in kind.laws(still(layout)) if isinstance(one, DeviceLaw)]

    change = kind.together(layout, [sizes])

    orbit = layout.response
    for _ in range(60):
        kicks = -sizes[:, None] * orbit[near]
        orbit = layout.response + law.patterns[0] @ kicks
    assert change == pytest.approx(orbit - layout.response, rel=1e-9, abs=1e-12)


def test_a_large_beta_beat_leaves_nothing_to_other_errors() -> None:
    """What gradients add together is neither gains of devices nor crosstalk."""
    layout = some_devices(9)
    errors = np.random.default_rng(6).standard_normal(300)
    record = make_record(layout, 6.0 * gradient_scatters(layout) * errors, 7)
    kinds = kinds_for(record)

    accepted, rounds = tournament(Workspace.of(record, kinds), kinds)

    assert [one.kind.id for one in accepted] == ["quadrupole-gradient"]
    assert rounds[-1].left(accepted[0].evidence) is None
    assert rounds[-1].space.bending > 0.8


def test_errors_that_stand_in_for_another_cause_add_nothing_together() -> None:
    """A corrector that sticks leaves errors of any size, and no bend."""
    layout = some_devices(9)
    record = make_record(layout, np.zeros(300), 8)
    stuck = record.setpoints.copy()
    stuck[200:, 5] = stuck[200, 5]
    moved = (stuck - record.setpoints) @ layout.response.T
    record = replace(record, readings=record.readings + moved)

    space = Workspace.of(record, kinds_for(record))

    assert space.bending < 0.05


@pytest.mark.parametrize("seed", [1, 2])
def test_the_sextupoles_of_the_table_are_told_beside_errors_of_all_bpms(seed: int) -> None:
    """They are half as strong as there: a part of the model, and no cause beside another."""
    layout = some_devices(9)
    record = make_record(layout, np.zeros(300), seed)
    beyond = effect("sextupole").refinement(Workspace.of(record, []).signals)
    gains = 1.0 + 0.1 * np.random.default_rng(seed).standard_normal(len(layout.response))
    record = replace(record, readings=(record.readings + 0.5 * beyond) * gains)
    kinds = kinds_for(record)

    accepted, rounds = tournament(Workspace.of(record, kinds), kinds)

    assert [one.kind.id for one in accepted] == ["bpm-gain"]
    assert rounds[-1].space.refining == pytest.approx(0.5, abs=0.2)
