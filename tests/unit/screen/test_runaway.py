"""Rows in which the loop has run away are left out and told; all else stays."""

import numpy as np
import pytest

from orbitfb.diagnose.screen.runaway import without_runaway
from tests.unit.hypotheses.small_records import make_record


def test_rows_in_which_a_loop_runs_away_are_left_out_and_told() -> None:
    record = make_record(41, sensed=lambda orbit: -orbit, gain=0.02, dither=1e-3, rows=400)
    found, (finding,) = without_runaway(record)
    assert 100 <= len(found) < len(record)
    np.testing.assert_array_equal(found.readings, record.readings[: len(found)])
    assert finding.rows == (len(found), 399)
    assert f"from row {len(found)} on" in finding.text


def test_a_loop_that_runs_away_at_once_stays() -> None:
    """Too few rows would be left."""
    record = make_record(41, sensed=lambda orbit: -orbit, gain=0.3, dither=1e-3, rows=60)
    assert without_runaway(record) == (record, [])


@pytest.mark.parametrize("step", [0.0, 3e2])
def test_a_walk_and_a_step_of_the_orbit_stay(step: float) -> None:
    record = make_record(41)
    record.setpoints[450:, 5] += step
    assert without_runaway(record) == (record, [])
