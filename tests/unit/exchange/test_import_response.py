"""A response matrix from elsewhere, in files that other programs wrote."""

import csv
import json
import os
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from foreign import Matlab73

from orbitfb.cli.app import app
from orbitfb.core.errors import ExchangeError
from orbitfb.measure.response_file import nominal_response, read_response
from orbitfb.physics.places import Ring
from orbitfb.policies.masking import MaskSettings

DATA = Path(__file__).parents[3] / "orbitfb/data"
RING = Ring.load()
CHANNELS = RING.channels("x")
BPMS, CORRECTORS = list(CHANNELS.bpms), list(CHANNELS.correctors)
ORDER = np.random.default_rng(7).permutation(180)
"""The order in which the files have the BPMs: not that of the table."""
SWAP = 9
"""A corrector whose column by the optics is at a right angle to that of number 3 (cosine 0.06)."""


@pytest.fixture(scope="module")
def matrix():
    """R of the optics by a formula of its own, 1 % off as a measured one is [m/A]."""
    places = np.genfromtxt(
        DATA / "places.csv", delimiter=",", names=True, dtype=None, encoding="utf-8"
    )
    ring = json.loads((DATA / "ring.json").read_text())
    b, c = places[places["kind"] == "BPM"], places[places["kind"] == "COR"]
    nu = ring["nu_x"]
    phase = 2 * np.pi * np.abs(b["mu_x_2pi"][:, None] - c["mu_x_2pi"])
    green = np.sqrt(b["beta_x_m"][:, None] * c["beta_x_m"]) * np.cos(phase - np.pi * nu)
    green /= 2 * np.sin(np.pi * nu)
    green -= b["eta_x_m"][:, None] * c["eta_x_m"] / (ring["alpha_c"] * ring["circumference_m"])
    exact = green * c["cal_x_rad_per_A"]
    return exact * (1 + 0.01 * np.random.default_rng(1).standard_normal(exact.shape))


@pytest.fixture(autouse=True)
def _in_an_empty_directory(tmp_path, matrix, monkeypatch):
    monkeypatch.chdir(tmp_path)


def taken(path, *arguments):
    code = app(["import", "response", str(path), *arguments], standalone_mode=False)
    assert code in (None, 0), code
    ring = Ring.load()
    out = Path("response.safetensors")
    return read_response(out, CHANNELS), nominal_response(ring, "x", out, MaskSettings())


def refused(path, *arguments):
    with pytest.raises(ExchangeError) as caught:
        app(["import", "response", str(path), *arguments], standalone_mode=False)
    assert not os.path.exists("response.safetensors")
    return str(caught.value)


def write_v5(path, matrix, **more):
    content = {"data": matrix, "bpm": np.array(BPMS, dtype=object)[ORDER],
               "cor": np.array(CORRECTORS, dtype=object)}  # fmt: skip
    scipy.io.savemat(path, {"RM": content | more}, do_compression=True)


NAMES = ("--bpm-names", "RM.bpm", "--corrector-names", "RM.cor")


def test_matlab_5_with_its_unit_stated(tmp_path, matrix):
    write_v5(tmp_path / "rm.mat", 1e3 * matrix[ORDER])
    measured, adopted = taken("rm.mat", "--matrix", "RM.data", *NAMES, "--unit", "mm/A")
    np.testing.assert_allclose(adopted, matrix, rtol=1e-12)
    assert measured.card["method"] == "imported"
    assert measured.card["unit"] == "mm/A"
    assert np.isnan(measured.base).all(), "nobody knows the setpoints it was measured around"


def test_matlab_5_transposed_and_in_kicks(tmp_path, matrix):
    write_v5(tmp_path / "rm.mat", (matrix / RING.calibration("x"))[ORDER].T)
    options = ("--matrix", "RM.data", *NAMES, "--unit", "mm/mrad", "--transpose")
    np.testing.assert_allclose(taken("rm.mat", *options)[1], matrix, rtol=1e-12)


def test_matlab_73_struct_with_cells_and_units(tmp_path, matrix):
    with Matlab73(tmp_path / "rm.mat") as mat:
        rm = mat.struct(mat.file, "RM")
        mat.numbers(rm, "data", 1e6 * matrix[ORDER])
        mat.cells(rm, "bpm", np.array(BPMS)[ORDER])
        mat.cells(rm, "cor", CORRECTORS)
        mat.text(rm, "units", "um/A")
    _, adopted = taken("rm.mat", "--matrix", "RM.data", *NAMES)
    np.testing.assert_allclose(adopted, matrix, rtol=1e-12)


def test_matlab_73_and_5_struct_arrays(tmp_path, matrix):
    zero = np.zeros((180, 180))
    with Matlab73(tmp_path / "new.mat") as mat:
        mat.struct_array(mat.file, "Rmat", "Data", [[matrix, zero], [zero, matrix]])
    old = np.empty((2, 2), dtype=[("Data", object)])
    for place in np.ndindex(2, 2):
        old[place] = (matrix if place[0] == place[1] else zero,)
    scipy.io.savemat(tmp_path / "old.mat", {"Rmat": old})
    for name in ("new.mat", "old.mat"):
        options = ("--matrix", "Rmat(1,1).Data", "--order", "table", "--unit", "m/A")
        np.testing.assert_allclose(taken(name, *options)[1], matrix, rtol=1e-12)
        os.remove("response.safetensors")
        assert "Rmat" in refused(name, "--matrix", "Rmat.Data", *options[2:])
        assert "(3,1)" in refused(name, "--matrix", "Rmat(3,1).Data", *options[2:])
        # of the second plane's coupling: nothing in it is a response of this one
        assert "does not look like" in refused(name, "--matrix", "Rmat(1,2).Data", *options[2:])


def test_hdf5_with_pvs_for_names_and_sigma(tmp_path, matrix):
    pv = dict(zip(BPMS, CHANNELS.orbit_pvs, strict=True))
    with h5py.File(tmp_path / "rm.h5", "w") as file:
        file["lab/R"] = matrix[ORDER]
        file["lab/R"].attrs["units"] = "m/A"
        file["lab/error"] = np.full((180, 180), 1e-6)
        file["bpms"] = np.array([pv[BPMS[i]] for i in ORDER], dtype="S")
        file["cors"] = list(CHANNELS.setpoint_pvs)
    measured, adopted = taken(
        "rm.h5", "--matrix", "/lab/R", "--sigma", "lab/error", "--bpm-names", "bpms",
        "--corrector-names", "cors",
    )  # fmt: skip
    np.testing.assert_allclose(adopted, matrix, rtol=1e-12)
    assert (measured.table.sigma == 1e-6).all()


def test_csv_with_names_on_its_sides(tmp_path, matrix):
    with (tmp_path / "rm.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["R [mm/A]", *CORRECTORS])
        writer.writerows([BPMS[i], *(1e3 * matrix[i])] for i in ORDER)
    np.testing.assert_allclose(taken("rm.csv")[1], matrix, rtol=1e-12)


def test_a_bare_csv_needs_names_from_somewhere(tmp_path, matrix):
    np.savetxt(tmp_path / "rm.csv", matrix[ORDER], delimiter=";")
    assert "the order is not guessed" in refused("rm.csv", "--unit", "m/A")
    (tmp_path / "b.txt").write_text("\n".join(np.array(BPMS)[ORDER]))
    (tmp_path / "c.txt").write_text("\n".join(CORRECTORS))
    options = ("--bpm-names", "@b.txt", "--corrector-names", "@c.txt")
    assert "is not guessed" in refused("rm.csv", *options)
    np.testing.assert_allclose(taken("rm.csv", *options, "--unit", "m/A")[1], matrix, rtol=1e-12)


def test_a_wrong_unit_is_seen_and_the_right_one_named(tmp_path, matrix):
    write_v5(tmp_path / "rm.mat", 1e3 * matrix[ORDER])
    said = refused("rm.mat", "--matrix", "RM.data", *NAMES, "--unit", "m/A")
    assert "1e+03 times as large" in said and "mm/A" in said


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda m: m.T, "--transpose"),
        (lambda m: -m, "opposite sign"),
        (lambda m: m[::-1], "opposite order"),
        (lambda m: m[:, :100], "shape (180, 100)"),
    ],
)
def test_what_the_optics_contradict_is_refused(tmp_path, matrix, spoil, words):
    write_v5(tmp_path / "rm.mat", spoil(matrix))
    said = refused("rm.mat", "--matrix", "RM.data", "--order", "table", "--unit", "m/A")
    assert words in said
    if "shape" not in words:
        options = ("--matrix", "RM.data", "--order", "table", "--unit", "m/A", "--anyway")
        code = app(["import", "response", "rm.mat", *options], standalone_mode=False)
        assert code in (None, 0, 1)
        assert os.path.exists("response.safetensors")


def test_two_exchanged_names_are_told_and_must_be_masked(tmp_path, matrix, capsys):
    swapped = list(CORRECTORS)
    swapped[3], swapped[SWAP] = swapped[SWAP], swapped[3]
    write_v5(tmp_path / "rm.mat", matrix[ORDER], cor=np.array(swapped, dtype=object))
    command = ["import", "response", "rm.mat", "--matrix", "RM.data", *NAMES, "--unit", "m/A"]
    assert app(command, standalone_mode=False) == 1
    bad = read_response((tmp_path / "response.safetensors"), CHANNELS).card["bad_correctors"]
    assert set(bad) == {CORRECTORS[3], CORRECTORS[SWAP]}


def test_what_is_not_there_is_not_measured(tmp_path, matrix):
    with h5py.File(tmp_path / "rm.h5", "w") as file:
        file["R"] = matrix[:, 2:]
        file["c"] = CORRECTORS[2:]
        file["b"] = BPMS
    options = ("--matrix", "R", "--bpm-names", "b", "--corrector-names", "c", "--unit", "m/A")
    app(["import", "response", "rm.h5", *options], standalone_mode=False)
    measured = read_response(tmp_path / "response.safetensors", CHANNELS)
    assert measured.card["not_measured"] == CORRECTORS[:2]
    assert np.isnan(measured.table.response[:, :2]).all()
    np.testing.assert_allclose(measured.table.response[:, 2:], matrix[:, 2:])


def test_a_matrix_without_a_number_is_refused(tmp_path, matrix):
    path = tmp_path / "empty.csv"
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["", *CORRECTORS])
        writer.writerows([name, *["nan"] * len(CORRECTORS)] for name in BPMS)
    assert "has no number" in refused(path, "--unit", "mm/A")
    assert not Path("response.safetensors").exists()


def test_unknown_and_repeated_names_are_listed(tmp_path, matrix, capsys):
    with h5py.File(tmp_path / "rm.h5", "w") as file:
        file["R"] = matrix
        file["strange"] = ["PH1A_C31", *(f"B{i}" for i in range(100)), *BPMS[101:]]
        file["mistyped"] = ["PH1A_C31", *BPMS[1:]]
        file["twice"] = [BPMS[1], *BPMS[1:]]
        file["c"] = CORRECTORS
    options = ("--matrix", "R", "--corrector-names", "c", "--unit", "m/A", "--bpm-names")
    said = refused("rm.h5", *options, "strange")
    assert "101 of 180 BPMs" in said and "'PH1A_C31' (did you mean PH1A_C" in said
    assert "one device" in refused("rm.h5", *options, "twice")
    words = ["import", "response", "rm.h5", *options, "mistyped"]
    assert app(words, standalone_mode=False) == 1  # the BPM that was meant is missing
    told = capsys.readouterr().out
    assert "PH1A_C31  is not in the places table (did you mean PH1A_C" in told
    assert f"{BPMS[0]}  was not valid in" in told


def test_both_planes_need_to_be_told_apart(tmp_path):
    with h5py.File(tmp_path / "rm.h5", "w") as file:
        file["R"] = np.zeros((360, 360))
        file["b"], file["c"] = BPMS * 2, CORRECTORS * 2
    options = ("--matrix", "R", "--bpm-names", "b", "--corrector-names", "c", "--unit", "m/A")
    assert "either plane" in refused("rm.h5", *options, "--planes", "xy")


def flagged() -> dict:
    """Import what has bad devices in it, and give the card of the file."""
    words = ["import", "response", "rm.mat", "--matrix", "RM.data", "--order", "table"]
    assert app([*words, "--unit", "m/A"], standalone_mode=False) == 1
    return read_response(Path("response.safetensors"), CHANNELS).card


def test_single_devices_of_another_size_are_told_and_the_rest_is_taken(tmp_path, matrix, capsys):
    """A BPM in other units, a strong corrector, and names that are one row off."""
    write_v5(tmp_path / "rm.mat", matrix * np.where(np.arange(180) == 4, 10.0, 1.0))
    answer = flagged()
    assert list(answer["bad_correctors"]) == [Ring.load().names("COR")[4]]
    assert "times as large" in next(iter(answer["bad_correctors"].values()))
    row = np.where(np.arange(180) == 4, 1000.0, 1.0)[:, None]
    write_v5(tmp_path / "rm.mat", matrix * row)
    answer = flagged()
    assert list(answer["bad_bpms"]) == [Ring.load().names("BPM")[4]]
    assert "lose the beam" in capsys.readouterr().out


def test_a_shift_of_the_names_is_told_with_its_size(tmp_path, matrix):
    write_v5(tmp_path / "rm.mat", np.roll(matrix, 1, axis=0))
    said = refused("rm.mat", "--matrix", "RM.data", "--order", "table", "--unit", "m/A")
    assert "rows are shifted by 1" in said


def test_exchanged_and_reversed_devices_are_told(tmp_path, matrix):
    spoilt = matrix.copy()
    spoilt[:, [4, 9]] = spoilt[:, [9, 4]]
    spoilt[7] *= -1
    write_v5(tmp_path / "rm.mat", spoilt)
    answer = flagged()
    names = Ring.load().names("COR")
    assert set(answer["bad_correctors"]) == {names[4], names[9]}
    assert names[9] in answer["bad_correctors"][names[4]]
    assert "opposite sign" in answer["bad_bpms"][Ring.load().names("BPM")[7]]


def test_a_device_that_the_table_lacks_is_left_out_and_told(tmp_path, matrix, capsys):
    with open("rm.csv", "w") as file:
        print("R [m/A]", *CORRECTORS, "NEWC", sep=",", file=file)
        for name, row in zip([*BPMS, "NEWB"], np.vstack([matrix, matrix[:1]]), strict=True):
            print(name, *row, 1.0, sep=",", file=file)
    measured, adopted = taken("rm.csv")
    np.testing.assert_allclose(adopted, matrix)
    assert measured.table.response.shape == (180, 180)
    told = capsys.readouterr().out
    assert "NEWB" in told and "NEWC" in told and "is not in the places table" in told
