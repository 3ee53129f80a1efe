"""Values of what is accepted, over the floor that it leaves."""

import numpy as np
import pytest

from orbitfb.diagnose.hypotheses.device_laws import evaluated
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.rounds import tournament
from orbitfb.diagnose.selection.settled import settled
from orbitfb.effects.laws import DeviceLaw
from orbitfb.effects.registry import effect
from tests.unit.hypotheses.small_records import (
    ROWS,
    kinds_for,
    lagging,
    make_record,
    recorded,
)

TAU = -0.1 / np.log(0.5)
"""Of a corrector that lacks half of what it lacked, a row of 0.1 s later [s]."""


def test_values_that_all_devices_share_are_told_over_the_floor_that_they_leave() -> None:
    record = make_record(43, currents=lagging(0.5))
    space, kind = Workspace.of(record, kinds_for(record)), effect("corrector-lag")
    (law,) = kind.laws(space.signals)
    assert isinstance(law, DeviceLaw)
    wrong = {"tau": 1.3 * TAU, "second": 1e-6}
    one = evaluated(kind, law, Scorer.of(space), (), wrong, 0, False, 3.0)

    found, after = settled(one, space)

    assert found.values["tau"] == pytest.approx(TAU, rel=0.01)
    assert found.sources[0].values == found.values
    assert found.evidence > one.evidence + 12.0
    assert np.mean(after.residual**2) < 0.5 * np.mean(space.residual**2)


def test_a_law_of_several_values_that_begins_late_is_found_at_those_that_are_its() -> None:
    """Of any size others have its shape, too: the whole record shows a share of a size, no more."""
    kind, late = effect("corrector-resonance"), 500
    record = make_record(44)
    values = {"frequency": 4.68, "damping": 0.44}
    acting = record.setpoints.copy()
    rows = record.rows(late, ROWS)
    acting[late:, [5]] = kind.drive(rows.setpoints[:, [5]], values, rows)
    added = (acting - record.setpoints) @ record.layout.response.T
    changed = recorded(record.layout, record.setpoints, record.readings + added)
    kinds = kinds_for(changed)

    accepted, _ = tournament(Workspace.of(changed, kinds), kinds)

    assert [(one.kind.id, one.places, one.onset) for one in accepted] == [(kind.id, (5,), late)]
    assert accepted[0].values["frequency"] == pytest.approx(4.68, rel=0.2)
