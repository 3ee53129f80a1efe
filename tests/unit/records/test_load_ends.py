"""Where a stretch ends, nothing is made up: what nobody knows is left out."""

import numpy as np
import pytest

from orbitfb.core.errors import RecordError
from orbitfb.records.reading.load import load
from tests.unit.records.record_files import arrays, record, save


def without(*names):
    return lambda made: {name: array for name, array in made.items() if name not in names}


def turned(made):
    return made | {"action": -made["action"]}


def lost_once(made):
    action = made["action"].copy()
    action[7] += 1e-3
    return made | {"action": action}


def cut(made, rows):
    return {name: array[rows] if len(array) == 120 else array for name, array in made.items()}


UNKNOWN = {
    "no action": without("action"),
    "no action, no next orbit": without("action", "next_orbit"),
    "actions of the other sign": turned,
    "an action that was not carried out": lost_once,
}


@pytest.mark.parametrize("case", UNKNOWN)
def test_the_last_row_tells_nothing_when_its_action_is_not_known(tmp_path, case):
    read = load(save(tmp_path / "record.npz", UNKNOWN[case](arrays()))).record
    assert len(read) == 120
    np.testing.assert_allclose(read.setpoints, record().setpoints[:120], atol=1e-12)
    np.testing.assert_allclose(read.readings, record().readings[:120], atol=1e-15)
    assert np.isnan(read.requested[-1]).all()
    assert np.isfinite(read.requested[:-1]).all()


@pytest.mark.parametrize("case", [*UNKNOWN, "no next orbit"])
def test_nor_does_the_last_row_before_a_gap(tmp_path, case):
    spoil = UNKNOWN.get(case, without("next_orbit"))
    keep = np.delete(np.arange(120), np.s_[40:45])
    loaded = load(save(tmp_path / "record.npz", cut(spoil(arrays()), keep)))
    read = loaded.record
    assert read.stretches == [slice(0, 40), slice(40, 115)]
    np.testing.assert_allclose(read.setpoints, record().setpoints[keep], atol=1e-12)
    np.testing.assert_allclose(read.readings, record().readings[keep], atol=1e-15)
    (gap,) = [finding for finding in loaded.findings if finding.rows]
    assert gap.check == "time-gap"
    assert "after row 39 of the file" in gap.text
    assert gap.rows == (38, 39)


def test_rows_in_pieces_of_one_need_their_actions(tmp_path):
    made = cut(without("action")(arrays()), np.delete(np.arange(120), np.s_[1:100:2]))
    with pytest.raises(RecordError, match=r"of 19 of 70 rows it is known .*'action'"):
        load(save(tmp_path / "record.npz", made))
