"""What devices that remember held when the record began is found with their law."""

import numpy as np

from orbitfb.diagnose.verdict.engine import diagnose
from tests.unit.hypotheses.small_records import CORRECTORS, Bent, make_record, remembered

HALF = 0.01
"""Half of the play [A]."""


def dragged(count: int) -> Bent:
    """Play, from the definition: every corrector began somewhere else in it."""
    return remembered(
        lambda held, row: np.clip(held, row - HALF, row + HALF),
        first=HALF * np.linspace(-1.0, 1.0, count),
    )


def test_a_play_has_its_width_wherever_its_correctors_began() -> None:
    found = diagnose(
        make_record(31, currents=dragged(CORRECTORS), dither=0.002, rows=500),
        seed=0,
        progress=lambda what, share: None,
    )
    assert [one.effect for one in found.causes] == ["corrector-hysteresis"]
    told = found.causes[0].parameters
    assert abs(told["width"].value - 2.0 * HALF) < 0.1 * 2.0 * HALF
    assert abs(told["share"].value - 1.0) < 0.05
