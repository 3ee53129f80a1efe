"""What a law adds in the row in which it begins is what its simulation adds in its first tick."""

import numpy as np
import pytest

from orbitfb.effects.build import layout_of
from orbitfb.effects.device_kinds import ActuatorKind
from orbitfb.effects.laws import DeviceLaw, Signals
from orbitfb.effects.registry import all_effects
from orbitfb.physics.effect import generator
from orbitfb.physics.places import Ring
from orbitfb.records.record import Record

ROWS = 12
KINDS = [kind for kind in all_effects().values() if isinstance(kind, ActuatorKind) and kind.sudden]


@pytest.fixture(scope="module")
def record() -> Record:
    layout = layout_of(Ring.load(), "x", 0.1)
    rng = np.random.default_rng(3)
    setpoints = 0.1 * np.cumsum(rng.standard_normal((ROWS, len(layout.correctors))), axis=0)
    readings = setpoints @ layout.response.T
    return Record(
        layout=layout,
        time=0.1 * np.arange(ROWS),
        starts=np.arange(ROWS) == 0,
        readings=readings,
        setpoints=setpoints,
        requested=np.full_like(setpoints, np.nan),
        readback=None,
        dither=None,
        reference=None,
        filled=np.zeros(readings.shape, dtype=bool),
        auxiliary={},
        source="test",
        digest="0" * 64,
    )


@pytest.mark.parametrize("kind", KINDS, ids=[kind.id for kind in KINDS])
def test_the_first_tick(kind: ActuatorKind, record: Record) -> None:
    signals = Signals(record, record.setpoints, record.readings)
    (law,) = kind.laws(signals)
    places = np.arange(len(record.layout.correctors))
    assert isinstance(law, DeviceLaw) and law.first is not None
    for values in kind.grid(record)[:: max(len(kind.grid(record)) // 4, 1)]:
        first = law.first(values, signals)
        assert first.shape == record.setpoints.shape
        for row in (0, 5, ROWS - 1):
            effect = kind.simulate(record.layout, places, values, generator(1, kind.id))
            wanted = record.setpoints[row]
            np.testing.assert_allclose(
                first[row], effect.actuate(wanted, row) - wanted, atol=1e-9, err_msg=str(values)
            )


def test_a_supply_that_trips_loses_all_and_one_that_hangs_nothing(record: Record) -> None:
    signals = Signals(record, record.setpoints, record.readings)
    (law,) = all_effects()["corrector-stuck"].laws(signals)
    assert isinstance(law, DeviceLaw) and law.first is not None
    hangs = law.first({"left": 1.0, "decay": 1e-9}, signals)
    trips = law.first({"left": 0.0, "decay": 1e-9}, signals)
    np.testing.assert_allclose(hangs, 0.0, atol=1e-12)
    np.testing.assert_allclose(trips, -record.setpoints)
