"""Missing numbers, as archives have them: what is left out is told, the rest is as it was."""

import numpy as np
import pytest

from orbitfb.records.reading.load import load
from tests.unit.records.record_files import save, small


def loaded(tmp_path, change):
    made = small()
    change(made)
    its = load(save(tmp_path / "record.npz", made))
    return its.record, {one.check: one for one in its.findings}


def whole(tmp_path):
    return loaded(tmp_path, lambda made: None)[0]


def test_a_reading_that_is_missing_is_one_reading(tmp_path):
    def change(made):
        made["orbit"][17, 3] = np.nan
        made["next_orbit"][16, 3] = np.inf

    record, found = loaded(tmp_path, change)
    assert record.filled.sum() == 1
    assert record.filled[17, 3]
    assert len(record) == len(whole(tmp_path))
    assert "1 readings of 1 BPMs" in found["invalid-readings"].text


def test_a_few_in_every_bpm_leave_every_row(tmp_path):
    """Each BPM lacks 3 % of its readings, and two rows of five are not whole."""
    lost = np.arange(120)[:, None] % 30 == np.arange(12)

    def change(made):
        made["orbit"][lost] = np.nan
        made["next_orbit"][:-1][lost[1:]] = np.nan

    record, _ = loaded(tmp_path, change)
    assert len(record) == len(whole(tmp_path))
    assert record.starts.sum() == 1
    assert record.filled[:120].sum() == lost.sum()


def test_a_dead_bpm_is_left_out_and_told(tmp_path):
    def change(made):
        made["orbit"][:, 3] = made["next_orbit"][:, 3] = np.nan
        made["reference"][:, 3] = np.nan

    record, found = loaded(tmp_path, change)
    assert record.readings.shape[1] == 11
    assert len(found["bpm-dropped"].devices) == 1


@pytest.mark.parametrize("name", ["orbit", "setpoint", "action"])
def test_rows_of_which_nothing_is_known_are_left_out_and_told(tmp_path, name):
    def change(made):
        made[name][40:44] = np.nan

    record, found = loaded(tmp_path, change)
    assert record.starts.sum() == 2
    assert "4 rows of 120, first row 40 of the file, left out" in found["rows-left-out"].text
    reference = whole(tmp_path)
    np.testing.assert_allclose(record.readings[:40], reference.readings[:40])
    np.testing.assert_allclose(record.setpoints[-50:], reference.setpoints[-50:])


def test_setpoints_alone_with_a_hole(tmp_path):
    """What was asked for is their difference: no row is made of one side of a hole."""

    def change(made):
        del made["action"], made["next_orbit"]
        made["setpoint"][40] = np.nan

    record, _ = loaded(tmp_path, change)
    assert np.isfinite(record.setpoints).all()
    steps = np.abs(np.diff(record.setpoints, axis=0))[~record.starts[1:]]
    assert steps.max() <= np.abs(np.diff(whole(tmp_path).setpoints, axis=0)).max() * (1 + 1e-9)


def test_setpoints_stand_for_missing_readbacks_and_slow_channels_keep_their_value(tmp_path):
    def change(made):
        made["readback"] = made["setpoint"] + 1e-3
        made["readback"][7, 2] = np.nan
        made["current"] = np.linspace(0.4, 0.3, 120)
        made["current"][[0, 9]] = np.nan

    record, found = loaded(tmp_path, change)
    assert record.readback[7, 2] == record.setpoints[7, 2]
    assert record.readback[8, 2] == pytest.approx(record.setpoints[8, 2] + 1e-3)
    current = record.auxiliary["current"]
    assert (current[0], current[9]) == (current[1], current[8])
    assert "2 rows without a number" in found["missing-values"].text
    assert "rows without a readback" in found["missing-readback"].text
