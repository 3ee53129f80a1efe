"""What is wrong with a record is said, with the array and the row; nothing is run or written."""

import json
import os
import struct
import zipfile

import h5py
import numpy as np
import pytest

from orbitfb.core.errors import RecordError
from orbitfb.records.reading.load import load, load_record
from tests.unit.records.record_files import arrays, save, small


def put(name, row, value, column=3):
    def change(made):
        made[name][(row, column) if made[name].ndim == 2 else row] = value

    return change


def replace(name, function):
    def change(made):
        made[name] = function(made[name])

    return change


def drop(*names):
    def change(made):
        for name in names:
            del made[name]

    return change


def rename(name, row, text):
    def change(made):
        made[name][row] = text

    return change


def meta(text):
    def change(made):
        made["meta"] = np.array(text)

    return change


def short(made):
    for name, array in made.items():
        if len(array) == 120:
            made[name] = array[:20]


def empty(made):
    for name, array in made.items():
        if len(array) == 120:
            made[name] = array[:0]


def twice(made):
    made["bpm_names"][5] = made["bpm_names"][2]


WRONG = {
    "most orbits lost": (
        put("orbit", slice(50, None), np.nan, slice(None)),
        ["'orbit'", "row 50", "column 0", "840 such values"],
    ),
    "a corrector mostly unknown": (
        put("setpoint", slice(5, 25), np.inf),
        ["'setpoint'", "row 5", "inf", "column 3"],
    ),
    "NaN in t": (put("t", 9, np.nan), ["'t'", "row 9"]),
    "NaN in model": (put("model_R", 2, np.nan), ["'model_R'", "row 2", "rows are BPMs"]),
    "too few columns in action": (
        replace("action", lambda a: a[:, :-1]),
        ["array 'action'", "(120, 9)", "setpoint (120, 10) call for"],
    ),
    "too few columns in setpoint": (
        replace("setpoint", lambda a: a[:, :-1]),
        ["array 'setpoint'", "(120, 9)", "action (120, 10) call for"],
    ),
    "time goes back": (put("t", 60, 1.0), ["'t'", "row 60", "does not increase"]),
    "time stands": (replace("t", np.zeros_like), ["'t'", "row 1", "it is 0 s in every row"]),
    "time stands at 5 s": (replace("t", lambda a: 0 * a + 5), ["'t'", "it is 5 s in every row"]),
    "a dead corrector": (
        put("setpoint", slice(None), np.nan),
        ["'setpoint'", "leave the corrector without readings", "its column of model_R"],
    ),
    "no BPM": (
        put("orbit", slice(None), np.nan, slice(None)),
        ["'orbit'", "1440 such values", "leave the BPM without readings"],
    ),
    "NaN in actions that are added up": (
        lambda made: (made.pop("setpoint"), put("action", 5, np.nan)(made)),
        ["'action'", "row 5"],
    ),
    "time of float32": (replace("t", lambda a: (a + 1.7e9).astype("f4")), ["'t'", "float32"]),
    "next orbit is the orbit": (
        lambda made: made.update(next_orbit=made["orbit"]),
        ["'next_orbit'", "row 0", "orbit itself"],
    ),
    "next orbit is of other ticks": (
        replace("next_orbit", lambda a: np.roll(a, 50, axis=0)),
        ["'next_orbit'", "row 0", "another order"],
    ),
    "next orbit is late": (
        replace("next_orbit", lambda a: np.roll(a, -1, axis=0)),
        ["'next_orbit'", "it is late"],
    ),
    "next orbit of one BPM": (
        put("next_orbit", slice(None), 0.5, 4),
        ["'next_orbit'", "1 columns", "column 4"],
    ),
    "too few rows in action": (replace("action", lambda a: a[:-1]), ["'action'", "(119, 10)"]),
    "orbit turned": (replace("next_orbit", np.transpose), ["'next_orbit'", "transpose it"]),
    "only orbit turned": (replace("orbit", np.transpose), ["'orbit'", "12 names", "transpose"]),
    "model turned": (replace("model_R", np.transpose), ["'model_R'", "(10, 12)", "transpose it"]),
    "orbit of one dimension": (replace("orbit", np.ravel), ["'orbit'", "shape"]),
    "orbit of three dimensions": (replace("orbit", lambda a: a[None]), ["'orbit'", "shape"]),
    "no orbit": (drop("orbit"), ["orbit", "is missing"]),
    "no names": (drop("bpm_names", "corr_names"), ["bpm_names, corr_names", "missing"]),
    "no currents": (drop("action", "setpoint"), ["action (or setpoint)", "missing"]),
    "few rows": (short, ["'orbit'", "20 rows"]),
    "no rows": (empty, ["'orbit'", "(0, 12)"]),
    "a name twice": (twice, ["'bpm_names'", "row 2", "row 5"]),
    "an unknown name": (rename("bpm_names", 4, "PH9Z_C99"), ["'bpm_names'", "row 4", "PH9Z_C99"]),
    "a magnet for a BPM": (rename("bpm_names", 1, "CH1A_C30"), ["'bpm_names'", "row 1"]),
    "an empty name": (rename("corr_names", 6, " "), ["'corr_names'", "row 6"]),
    "too few names": (replace("corr_names", lambda a: a[:-1]), ["'corr_names'", "9 names"]),
    "names are numbers": (replace("bpm_names", lambda a: np.arange(12)), ["'bpm_names'", "text"]),
    "orbit is text": (replace("orbit", lambda a: a.astype(str)), ["'orbit'", "numbers"]),
    "orbit is complex": (replace("orbit", lambda a: a + 0j), ["'orbit'", "complex"]),
    "orbit is objects": (replace("orbit", lambda a: a.astype(object)), ["'orbit'", "pickled"]),
    "meta is no JSON": (meta("{dt_s: 0.1"), ["'meta'", "no JSON"]),
    "meta is deep": (meta("[" * 100_000), ["'meta'", "no JSON"]),
    "meta is a list": (meta("[1]"), ["'meta'", "list"]),
    "a period of zero": (meta('{"dt_s": 0}'), ["'meta'", "dt_s"]),
    "a period without end": (meta('{"dt_s": 1' + "0" * 400 + "}"), ["'meta'", "dt_s"]),
    "an orbit of no size": (replace("orbit", lambda a: a * 1e-200), ["'orbit'", "no unit"]),
    "a model beyond size": (replace("model_R", lambda a: a * 1e160), ["'model_R'", "no unit"]),
    "an unknown unit": (meta('{"units": {"orbit": "inch"}}'), ["'meta'", "inch"]),
    "an unknown plane": (meta('{"planes": "z"}'), ["'meta'", "planes"]),
    "a model of zeros": (replace("model_R", np.zeros_like), ["'model_R'", "zero"]),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_array_is_named(tmp_path, case):
    change, words = WRONG[case]
    made = small()
    change(made)
    path = save(tmp_path / "record.npz", made)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(RecordError) as error:
        load(path)
    for word in [*words, "record.npz"]:
        assert word in str(error.value)
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("case", [case for case in WRONG if "objects" not in case
                                  and "text" not in case and "names are" not in case])  # fmt: skip
def test_a_wrong_array_is_named_in_hdf5(tmp_path, case):
    change, words = WRONG[case]
    made = small()
    change(made)
    with h5py.File(tmp_path / "record.h5", "w") as file:
        for name, array in made.items():
            file[name] = array.astype("S") if array.dtype.kind == "U" and array.ndim else (
                array.item() if array.dtype.kind == "U" else array)  # fmt: skip
    with pytest.raises(RecordError) as error:
        load(tmp_path / "record.h5")
    assert words[0].strip("'") in str(error.value)


class Trap:
    """Pickles to something that leaves a mark when it is opened."""

    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return os.mkdir, (self.mark,)


def test_nothing_pickled_is_opened(tmp_path):
    made = small() | {"meta": np.array([Trap(str(tmp_path / "mark"))], dtype=object)}
    path = tmp_path / "record.npz"
    np.savez(path, **made)
    with pytest.raises(RecordError, match=r"'meta'.*pickled"):
        load(path)
    assert not (tmp_path / "mark").exists()


def header(shape, kind="<f8"):
    text = repr({"descr": kind, "fortran_order": False, "shape": shape}).encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


@pytest.mark.nightly
def test_a_zip_bomb_is_not_unpacked(tmp_path):
    path = tmp_path / "bomb.npz"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("orbit.npy", "w", force_zip64=True) as file,
    ):
        file.write(header((20_000_000,)))
        for _ in range(160):
            file.write(bytes(1_000_000))
    with pytest.raises(RecordError, match="zip bomb"):
        load(path)
    with pytest.raises(RecordError, match=r"unpacks to .*'orbit' alone"):
        load(path, largest=2**20)


@pytest.mark.parametrize("shape", [(10**9, 10**9), (-1, 5), (3, 3)])
def test_a_forged_header_is_refused(tmp_path, shape):
    path = tmp_path / "record.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("orbit.npy", header(shape) + bytes(80))
    with pytest.raises(RecordError, match="'orbit'"):
        load(path)


def test_an_array_that_is_there_twice(tmp_path):
    made = small()
    made["setpoints"] = made["setpoint"]
    with pytest.raises(RecordError, match=r"setpoint.*twice"):
        load(save(tmp_path / "record.npz", made))


@pytest.mark.parametrize("name", ["record.npz", "record.h5"])
@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"no record", bytes(5000)])
def test_a_file_that_is_no_record(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(RecordError, match=name):
        load(tmp_path / name)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.999])
def test_a_truncated_file(tmp_path, share):
    path = save(tmp_path / "record.npz", small())
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(RecordError, match="damaged or truncated"):
        load(path)


def test_a_damaged_byte_is_seen(tmp_path):
    path = save(tmp_path / "record.npz", small())
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x55
    path.write_bytes(content)
    with pytest.raises(RecordError, match=r"record\.npz"):
        load(path)


def test_paths_that_lead_nowhere(tmp_path):
    with pytest.raises(RecordError, match="No such file"):
        load(tmp_path / "none.npz")
    (tmp_path / "one.npz").symlink_to(tmp_path / "two.npz")
    (tmp_path / "two.npz").symlink_to(tmp_path / "one.npz")
    with pytest.raises(RecordError, match="symbolic links"):
        load(tmp_path / "one.npz")
    with pytest.raises(RecordError, match="without segments"):
        load(tmp_path)
    (tmp_path / "record.csv").write_text("1,2")
    with pytest.raises(RecordError, match=r"not in '\.csv'"):
        load(tmp_path / "record.csv")
    os.mkfifo(tmp_path / "pipe.npz")
    with pytest.raises(RecordError, match="no plain file"):
        load(tmp_path / "pipe.npz")
    (tmp_path / "broken.h5").write_bytes(b"x" * 100)
    with pytest.raises(RecordError, match=r"broken\.h5"):
        load(tmp_path)


def test_a_link_out_of_an_hdf5_file(tmp_path):
    with h5py.File(tmp_path / "record.h5", "w") as file:
        file["orbit"] = h5py.ExternalLink("/etc/passwd", "x")
    with pytest.raises(RecordError, match="'orbit' is a link"):
        load(tmp_path / "record.h5")
    with h5py.File(tmp_path / "large.h5", "w") as file:
        file.create_dataset("orbit", shape=(10**6, 10**6), chunks=(10, 10), dtype="f8")
    with pytest.raises(RecordError, match="are allowed"):
        load(tmp_path / "large.h5")
    with h5py.File(tmp_path / "group.h5", "w") as file:
        file["lab/orbit"] = np.zeros((3, 3))
    with pytest.raises(RecordError, match=r"holds only groups \(lab\)"):
        load(tmp_path / "group.h5")


def test_planes_and_models_that_do_not_fit(tmp_path):
    path = save(tmp_path / "record.npz", small("xy"))
    with pytest.raises(RecordError, match=r"shape \(2, 2\)"):
        load_record(path, response=np.ones((2, 2)))
    with pytest.raises(RecordError, match="period"):
        load_record(path, period=-1.0)
    path = save(tmp_path / "single.npz", small())
    with pytest.raises(RecordError, match="not in xy"):
        load_record(path, planes="xy")


def test_a_foreign_record_needs_its_model(tmp_path):
    made = small()
    made["bpm_names"] = np.array([f"B{i}" for i in range(12)])
    made["corr_names"] = np.array([f"K{i}" for i in range(10)])
    del made["model_R"]
    with pytest.raises(RecordError, match="'model_R' is missing"):
        load(save(tmp_path / "record.npz", made))


def test_hints_that_do_not_fit_the_columns(tmp_path):
    made = arrays() | {"meta": np.array(json.dumps({"bpm_planes": "xy"}))}
    with pytest.raises(RecordError, match="2 planes for the 180"):
        load(save(tmp_path / "record.npz", made))
