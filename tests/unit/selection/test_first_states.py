"""What devices that remember held when the record began is found with their law."""

import numpy as np

from orbitfb.diagnose.verdict.engine import diagnose
from orbitfb.physics.optics import Matrix
from tests.unit.hypotheses.small_records import make_record

HALF = 0.01
"""Half of the play [A]."""


def dragged(currents: Matrix) -> Matrix:
    """Play, from the definition: every corrector began somewhere else in it."""
    held = currents[0] + HALF * np.linspace(-1.0, 1.0, currents.shape[1])
    for row in currents:
        held = np.clip(held, row - HALF, row + HALF)
    return held[None]


def test_a_play_has_its_width_wherever_its_correctors_began() -> None:
    found = diagnose(
        make_record(31, currents=dragged, dither=0.002), seed=0, progress=lambda what, share: None
    )
    assert [one.effect for one in found.causes] == ["corrector-hysteresis"]
    told = found.causes[0].parameters
    assert abs(told["width"].value - 2.0 * HALF) < 0.1 * 2.0 * HALF
    assert abs(told["share"].value - 1.0) < 0.05
