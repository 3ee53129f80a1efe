"""Units that are stated are taken, and units that contradict each other are refused."""

import json

import h5py
import numpy as np
import pytest

from orbitfb.core.errors import RecordError
from orbitfb.records.reading.load import load, load_record
from tests.unit.records.record_files import arrays, save, small


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


@pytest.mark.parametrize(
    ("units", "words"),
    [
        ("um", "units = 'um', which says not of what"),
        ("orbits in um", "which says not of what"),
        (["um"], "which says not of what"),
        ({"orbit": 1e-6}, "units.orbit = 1e-06"),
        ({"orbits": "um"}, "gives a unit of 'orbits'.*do you mean orbit"),
        ({"next_orbit": "um"}, "'orbit' has no unit, but next_orbit is said to be in 'um'"),
    ],
)
def test_units_that_would_not_be_used(tmp_path, units, words):
    made = small() | {"meta": meta(dt_s=0.1, units=units)}
    with pytest.raises(RecordError, match=words):
        load(save(tmp_path / "record.npz", made))


@pytest.mark.parametrize("units", ["orbit in mm", {"time": "s", "gap": "m", "orbit": None}, None])
def test_units_that_are_the_usual_ones_or_of_something_else(tmp_path, units):
    made = small() | {"meta": meta(dt_s=0.1, units=units)}
    assert load(save(tmp_path / "record.npz", made)).record.layout.period == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("factor", "unit"), [(1e3, "mm"), (1e3, None), (1.0, "m"), (1.0, None), (1e6, None)]
)
def test_gaps_of_insertion_devices_are_lengths(tmp_path, factor, unit):
    """Whatever they are called; where nobody says in what, their size does."""
    gap = np.linspace(8e-3, 0.12, 200)
    made = small() | {"id_gap_7": gap[: len(small()["t"])] * factor}
    made["meta"] = meta(dt_s=0.1, units={"id_gap_7": unit})
    loaded = load(save(tmp_path / "record.npz", made)).record
    (its,) = loaded.auxiliary.values()
    assert its[:-1] == pytest.approx(gap[: len(its) - 1])


@pytest.mark.parametrize("attribute", ["units", "unit"])
def test_the_unit_of_a_gap_in_hdf5_is_its_attribute(tmp_path, attribute):
    made = small()
    gap = np.linspace(1.2, 4.0, len(made["t"]))
    path = tmp_path / "record.h5"
    with h5py.File(path, "w") as file:
        for name, array in made.items():
            file[name] = array.astype("S") if array.dtype.kind == "U" else array
        file["id_gap"] = gap
        file["id_gap"].attrs[attribute] = "cm"
    loaded = load(path)
    (its,) = loaded.record.auxiliary.values()
    assert its[:-1] == pytest.approx(1e-2 * gap[: len(its) - 1])
    assert not [one for one in loaded.findings if one.check.startswith("gap")]


def test_a_gap_that_is_left_out_or_whose_unit_is_guessed_is_told(tmp_path):
    made = small() | {"gap_1": np.full(len(small()["t"]), 20.0)}
    made |= {"gap_2": made["gap_1"].copy(), "gap_3": made["gap_1"][:-5], "meta": meta(dt_s=0.1)}
    made["gap_2"][7] = np.nan
    loaded = load(save(tmp_path / "record.npz", made))
    assert list(loaded.record.auxiliary) == ["gap_1"]
    told = {one.check: one.text for one in loaded.findings if one.check == "gap-unit"}
    assert told == {"gap-unit": "array 'gap_1' has no unit; by its size it is taken to be in mm"}
    texts = [one.text for one in loaded.findings if one.check == "gap-dropped"]
    assert "row 7 is not finite" in texts[0]
    assert f"rows of {len(made['t'])}" in texts[1]


def test_a_gap_in_a_unit_that_is_no_length_is_refused(tmp_path):
    made = small() | {"gap": np.linspace(8.0, 120.0, len(small()["t"]))}
    made["meta"] = meta(dt_s=0.1, units={"gap": "A"})
    with pytest.raises(RecordError, match=r"says that gap is in .A..*use one of m, cm, mm"):
        load(save(tmp_path / "record.npz", made))


@pytest.mark.parametrize(
    ("key", "near"), [("unit", "units"), ("dt", "dt_s"), ("Planes", "planes"), ("note", None)]
)
def test_a_key_that_is_nearly_one_that_is_read(tmp_path, key, near):
    made = small() | {"meta": meta(dt_s=0.1, **{key: "x"})}
    told = [one for one in load(save(tmp_path / "record.npz", made)).findings
            if one.check == "unread-meta"]  # fmt: skip
    expected = [] if near is None else [f"meta: '{key}' is not read; did you mean '{near}'?"]
    assert [one.text for one in told] == expected
    assert all(one.severity == "warning" for one in told)


def hdf5(path, made, units):
    with h5py.File(path, "w") as file:
        for name, array in made.items():
            file[name] = array.astype("S") if array.dtype.kind == "U" else array
            if name in units:
                file[name].attrs["units"] = units[name]
    return path


def test_units_beside_the_arrays_of_hdf5(tmp_path):
    made = small()
    for name in ("orbit", "next_orbit", "reference"):
        made[name] = made[name] * 1e3
    read = load_record(hdf5(tmp_path / "record.h5", made, {"orbit": "um", "t": b"s"}))
    same = load_record(save(tmp_path / "same.npz", small()))
    np.testing.assert_allclose(read.readings, same.readings, rtol=1e-12)
    assert read.layout.period == pytest.approx(0.1)
    made["meta"] = np.array(b'{"units": {"orbit": "mm"}}')
    with pytest.raises(RecordError, match="'orbit' is in 'um' by its attribute, in 'mm' by meta"):
        load(hdf5(tmp_path / "other.h5", made, {"orbit": "um"}))


@pytest.mark.parametrize(("written", "factor"), [("microns", 1e6), ("µm", 1e6), ("MM", 1e3)])
def test_units_of_a_record_are_taken_as_people_write_them(tmp_path, written, factor):
    made = small()
    usual = load_record(save(tmp_path / "usual.npz", made))
    for name in ("orbit", "next_orbit", "reference"):
        made[name] = made[name] * factor / 1e3
    made["meta"] = meta(units={"orbit": written, "action": "Amps", "model_R": "mm/Ampere"})
    told = load_record(save(tmp_path / "told.npz", made))
    np.testing.assert_allclose(told.readings, usual.readings, rtol=1e-12)
