"""Values between those of a grid."""

import numpy as np
import pytest

from orbitfb.diagnose.scan_between import between
from orbitfb.effects.registry import all_effects

SLEW = all_effects()["corrector-slew"]
GRID = [{"rate": float(rate)} for rate in np.geomspace(1e-3, 1.0, 13)]


def heights(values):
    """A limit at 0.237 A/s of a cell, as sharp as half a step of the grid; little of one place."""
    far = np.log(values["rate"] / 0.237) / np.log(1.4)
    return {"single": 40.0, "cell": 5e4 * float(np.exp(-(far**2)))}


def test_what_is_sharper_than_the_grid_is_found():
    (found,) = between(SLEW, GRID, [heights(values) for values in GRID], heights)
    assert found["rate"] == pytest.approx(0.237, rel=0.05)
    assert heights(found)["cell"] > max(heights(values)["cell"] for values in GRID)


@pytest.mark.parametrize("edge", [0, -1])
def test_a_grid_may_end_at_its_highest(edge):
    def falling(values):
        return {"single": 100.0 - abs(np.log(values["rate"] / GRID[edge]["rate"]))}

    (found,) = between(SLEW, GRID, [falling(values) for values in GRID], falling)
    assert 1e-3 <= found["rate"] <= 1.0


def test_what_cannot_be_worth_it_costs_no_time():
    def never(values):
        raise AssertionError(values)

    low = [{"single": 49.0} for _ in GRID]
    assert not list(between(SLEW, GRID, low, never))
    high = [{"single": 1e4} for _ in GRID]
    gain = all_effects()["corrector-gain"]
    assert not list(between(gain, [{"gain": 0.1}], high[:1], never))
    two = [{"width": w, "share": s} for w in (0.1, 0.2) for s in (0.1, 0.2)]
    assert not list(between(all_effects()["corrector-hysteresis"], two, high[:4], never))
