"""Limits of single correctors, each of which has a range of setpoints of its own."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.rounds import tournament
from orbitfb.effects.laws import DeviceLaw, Signals
from orbitfb.effects.registry import effect
from orbitfb.records.layout import Devices
from orbitfb.records.record import Record
from tests.unit.hypotheses.small_records import (
    BPMS,
    CORRECTORS,
    NOISE,
    ROWS,
    kinds_for,
    make_record,
    recorded,
)

LIMITED = 5


def limited(rows: int, onset: int, seed: int) -> tuple[Record, float]:
    """Setpoints about a mean of every corrector's own; a limit that one passes in some rows.

    Args:
        rows: How many of those from the onset on are beyond it.
        onset: Row from which there is a limit.
        seed: Of all.
    """
    rng, layout = np.random.default_rng(seed), make_record(11).layout
    means = rng.uniform(0.5, 5.0, CORRECTORS)
    setpoints = means + 0.1 * rng.standard_normal((ROWS, CORRECTORS))
    largest = np.sort(setpoints[onset:, LIMITED])[::-1]
    limit = 0.5 * (largest[rows - 1] + largest[rows])
    acting = setpoints.copy()
    acting[onset:, LIMITED] = np.minimum(acting[onset:, LIMITED], limit)
    kicks = (1e-3 * rng.standard_normal((ROWS, CORRECTORS))).cumsum(axis=0)
    noise = 0.1 * NOISE * rng.standard_normal((ROWS, BPMS))
    return recorded(layout, setpoints, (acting + kicks) @ layout.response.T + noise), float(limit)


@pytest.mark.parametrize(("rows", "onset"), [(1, 0), (3, 0), (60, 400)])
def test_a_limit_is_told_though_few_rows_show_it_or_it_begins_late(rows: int, onset: int) -> None:
    record, limit = limited(rows, onset, 6)
    kinds = kinds_for(record)

    accepted, _ = tournament(Workspace.of(record, kinds), kinds)

    found = [(one.kind.id, one.places) for one in accepted]
    assert found == [("corrector-saturation", (LIMITED,))]
    assert accepted[0].values["limit"] == pytest.approx(limit, abs=0.03)
    assert bool(accepted[0].onset) == bool(onset)


def test_a_limit_whose_corner_is_half_as_wide_as_the_range_is_told() -> None:
    """It bends all that the setpoint does: a gain of the corrector is nearly as likely."""
    rng, layout = np.random.default_rng(8), make_record(11).layout
    setpoints = 5.0 + 0.1 * rng.standard_normal((ROWS, CORRECTORS))
    acting = setpoints.copy()
    acting[:, LIMITED] -= 0.3 * np.log1p(np.exp((setpoints[:, LIMITED] - 5.0) / 0.3))
    kicks = (1e-3 * rng.standard_normal((ROWS, CORRECTORS))).cumsum(axis=0)
    noise = 0.1 * NOISE * rng.standard_normal((ROWS, BPMS))
    record = recorded(layout, setpoints, (acting + kicks) @ layout.response.T + noise)
    kinds = kinds_for(record)

    accepted, _ = tournament(Workspace.of(record, kinds), kinds)

    assert [(one.kind.id, one.places) for one in accepted] == [("corrector-saturation", (LIMITED,))]
    assert accepted[0].values["limit"] == pytest.approx(5.0, abs=0.02)
    assert accepted[0].values["rounding"] == pytest.approx(0.3, rel=0.05)


def test_a_ring_of_one_corrector_has_limits() -> None:
    """One value for all devices is no value of each, though there is one of each."""
    record, _ = limited(3, 0, 6)
    layout = record.layout
    devices = Devices(layout.correctors.names[:1], ("x",), ("",))
    single = replace(layout, correctors=devices, response=layout.response[:, [LIMITED]])
    alone = recorded(single, record.setpoints[:, [LIMITED]], record.readings)
    kind = effect("corrector-saturation")
    (law,) = kind.laws(Signals(alone, alone.setpoints, alone.readings))
    assert isinstance(law, DeviceLaw)
    assert law.first is not None
    values = {"limit": 1.0, "side": 0.0, "rounding": 1e-6}
    lost = law.first(values, Signals(alone, alone.setpoints, alone.readings))
    assert lost == pytest.approx(np.clip(alone.setpoints, -1.0, 1.0) - alone.setpoints)
