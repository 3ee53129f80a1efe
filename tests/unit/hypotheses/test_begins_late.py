"""A law that begins in the middle of a record, followed by what the simulation does from there."""

import numpy as np
import pytest

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.refit import Course
from orbitfb.effects.laws import Signals
from orbitfb.effects.registry import effect
from orbitfb.physics.optics import Matrix
from tests.unit.hypotheses.small_records import make_record

ROW = 300


def simulated(name: str, values: dict[str, float], setpoints: Matrix, place: int) -> Vector:
    """Current of a corrector that an effect strikes from a row on, beyond its setpoint, (N,)."""
    layout = make_record(1, rows=3).layout
    part = effect(name).simulate(layout, np.array([place]), values, np.random.default_rng(0))
    found = np.zeros(len(setpoints))
    for row in range(ROW, len(setpoints)):
        found[row] = part.actuate(setpoints[row], row)[place] - setpoints[row, place]
    return found


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("corrector-deadband", {"width": 0.05}),
        ("corrector-slew", {"rate": 0.1}),
        ("corrector-hysteresis", {"width": 0.06, "share": 1.0}),
        ("corrector-stuck", {"left": 0.0}),
    ],
)
def test_what_has_a_threshold_begins_where_the_current_is(
    name: str, values: dict[str, float]
) -> None:
    record = make_record(2, dither=0.02)
    signals = Signals(record, record.setpoints, record.readings)
    law, *_ = effect(name).laws(signals)
    course = Course(law, (4,), values, np.ones(1), ROW)  # type: ignore[arg-type]
    (told,) = course.of(signals, values)
    wanted = simulated(name, values, record.setpoints, 4)
    assert np.abs(wanted).max() > 0.01
    np.testing.assert_allclose(told[:, 0], wanted, atol=1e-12)
