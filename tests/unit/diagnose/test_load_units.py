"""Units that are stated are taken, and units that contradict each other are refused."""

import json

import numpy as np
import pytest
from record_files import arrays, save, small

from orbitfb.core.errors import RecordError
from orbitfb.diagnose.load import load, load_record


def meta(**content):
    return np.array(json.dumps(content))


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_stamps_in_another_unit_than_the_period(tmp_path, factor, unit):
    made = arrays()
    made["t"] = made["t"] * factor
    with pytest.raises(RecordError, match=rf'if t is in {unit}, say so in meta: .*"t": "{unit}"'):
        load(save(tmp_path / "record.npz", made | {"meta": meta(dt_s=0.1)}))
    told = made | {"meta": meta(dt_s=0.1, units={"t": unit})}
    assert load_record(save(tmp_path / "record.npz", told)).layout.period == pytest.approx(0.1)


def test_a_period_in_another_unit_than_the_stamps(tmp_path):
    made = small() | {"meta": meta(dt_s=100)}
    with pytest.raises(RecordError, match=r"0\.1 s apart, meta says dt_s = 100, a factor of 1e3"):
        load(save(tmp_path / "record.npz", made))
