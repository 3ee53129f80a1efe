"""Formats of measured responses, and devices that a table lacks or a plane has not."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from orbitfb.core.errors import ExchangeError
from orbitfb.loco.reading import Request, load
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response


@pytest.fixture(scope="module")
def ring() -> Ring:
    return Ring.load()


@pytest.fixture(scope="module")
def nominal(ring: Ring) -> dict[str, np.ndarray]:
    return {plane: response(ring, plane) for plane in ("x", "y")}


def csv(path: Path, rows, columns, matrix, unit="m/A") -> Path:
    lines = [",".join([f"R [{unit}]", *columns])]
    lines += [",".join([n, *map(repr, map(float, r))]) for n, r in zip(rows, matrix, strict=True)]
    path.write_text("\n".join(lines) + "\n")
    return path


def per_kick(ring: Ring, matrix: np.ndarray, plane: str) -> np.ndarray:
    return matrix / ring.calibration(plane)


def test_a_csv_of_names_is_read_with_what_the_table_lacks_left_out(ring, nominal, tmp_path) -> None:
    rows = [*ring.names("BPM")[:40], "NEW"]
    matrix = np.vstack([nominal["x"][:40], np.ones(180)])
    file = csv(tmp_path / "m.csv", rows, ring.names("COR"), matrix)
    loaded = load(Request(file, planes="x"), ring)
    assert loaded.measured.response["x", "x"].shape == (40, 180)
    assert np.allclose(loaded.measured.response["x", "x"], per_kick(ring, nominal["x"][:40], "x"))
    assert "NEW" in loaded.notes[0]


def test_planes_may_have_other_devices(ring, nominal, tmp_path) -> None:
    rows = [f"{n}:x" for n in ring.names("BPM")[:30]] + [f"{n}:y" for n in ring.names("BPM")[:20]]
    columns = [f"{n}:x" for n in ring.names("COR")[:9]] + [f"{n}:y" for n in ring.names("COR")[5:]]
    matrix = np.zeros((50, 9 + 175))
    matrix[:30, :9], matrix[30:, 9:] = nominal["x"][:30, :9], nominal["y"][:20, 5:]
    loaded = load(Request(csv(tmp_path / "m.csv", rows, columns, matrix)), ring)
    assert {p: len(v) for p, v in loaded.measured.correctors.items()} == {"x": 9, "y": 175}
    assert set(loaded.measured.response) == {("x", "x"), ("y", "y")}


def test_units_of_kicks_and_of_currents_give_the_same(ring, nominal, tmp_path) -> None:
    matrix = per_kick(ring, nominal["y"], "y") * 1e3
    names = ring.names("BPM"), ring.names("COR")
    file = csv(tmp_path / "m.csv", *names, matrix, "mm/rad")
    loaded = load(Request(file, planes="y"), ring)
    assert np.allclose(loaded.measured.response["y", "y"] * 1e3, matrix)


def test_the_middle_layer_says_its_unit_and_planes(ring, nominal, tmp_path) -> None:
    blocks = np.empty((2, 2), dtype=object)
    for i, p in enumerate("xy"):
        for j in range(2):
            data = nominal[p] if i == j else np.zeros((180, 180))
            blocks[i, j] = {"Data": data * 1e3, "UnitsString": "mm/Ampere"}
    wanted = np.empty((2, 2), dtype=[("Data", object), ("UnitsString", object)])
    for i in range(2):
        for j in range(2):
            wanted[i, j] = (blocks[i, j]["Data"], blocks[i, j]["UnitsString"])
    savemat(tmp_path / "r.mat", {"Rmat": wanted})
    loaded = load(Request(tmp_path / "r.mat"), ring)
    for p in ("x", "y"):
        assert np.allclose(loaded.measured.response[p, p], per_kick(ring, nominal[p], p))
    assert not loaded.measured.has_cross
    assert "order of the places table" in loaded.notes[0]
    only = load(Request(tmp_path / "r.mat", planes="x"), ring)
    assert only.measured.planes == ("x",)


def test_a_loco_file_is_read_by_its_kicks_and_noise(ring, nominal, tmp_path) -> None:
    orbits = np.zeros((360, 360))
    for k, p in enumerate("xy"):
        own = slice(180 * k, 180 * (k + 1))
        orbits[own, own] = per_kick(ring, nominal[p], p) * 0.1e-3 * 1e3
    kicks = np.full((180, 1), 0.1)
    savemat(
        tmp_path / "loco.mat",
        {
            "LocoMeasData": {"M": orbits, "BPMSTD": np.full((360, 1), 1e-3)},
            "CMData": {"HCMKicks": kicks, "VCMKicks": kicks},
        },
    )
    loaded = load(Request(tmp_path / "loco.mat"), ring)
    assert np.allclose(loaded.measured.response["y", "y"], per_kick(ring, nominal["y"], "y"))
    assert np.allclose(loaded.measured.sigma["x", "x"], np.sqrt(2) * 1e-6 / 1e-4)


@pytest.mark.parametrize("suffix", [".npz", ".json", ".npy"])
def test_numpy_and_json(ring, nominal, tmp_path, suffix: str) -> None:
    file = tmp_path / f"m{suffix}"
    parts = {
        "response": nominal["x"],
        "bpms": np.array(ring.names("BPM")),
        "correctors": np.array(ring.names("COR")),
        "units": "m/A",
    }
    if suffix == ".npz":
        np.savez(file, **parts)
    elif suffix == ".npy":
        np.save(file, nominal["x"])
    else:
        plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in parts.items()}
        file.write_text(json.dumps(plain))
    loaded = load(Request(file, planes="x", unit="m/A"), ring)
    assert np.allclose(loaded.measured.response["x", "x"], per_kick(ring, nominal["x"], "x"))


def test_holes_are_said_and_do_not_count(ring, nominal, tmp_path) -> None:
    matrix = nominal["x"].copy()
    matrix[5] = np.nan
    np.savez(
        tmp_path / "m.npz", response=matrix, bpms=ring.names("BPM"),
        correctors=ring.names("COR"), units="m/A",
    )  # fmt: skip
    loaded = load(Request(tmp_path / "m.npz", planes="x"), ring)
    assert "180 elements were not measured (1 whole rows" in loaded.notes[-1]


def test_noise_of_the_command_line_is_per_kick(ring, nominal, tmp_path) -> None:
    np.save(tmp_path / "m.npy", nominal["x"])
    request = Request(tmp_path / "m.npy", planes="x", unit="m/A", noise=1e-6, kick=5e-5)
    assert np.allclose(load(request, ring).measured.sigma["x", "x"], 0.02)


@pytest.mark.parametrize(
    ("rows", "options", "told"),
    [
        (["NOBODY"] * 180, {"planes": "x"}, "not in the places table"),
        (None, {}, "may be of either plane"),
        (None, {"planes": "x", "unit": "mm/A"}, "the file says"),
    ],
)
def test_what_cannot_be_known_is_asked_for(ring, nominal, tmp_path, rows, options, told) -> None:
    names = [f"{n}{i}" for i, n in enumerate(rows)] if rows else ring.names("BPM")
    file = csv(tmp_path / "m.csv", names, ring.names("COR"), nominal["x"])
    with pytest.raises(ExchangeError, match=told):
        load(Request(file, **options), ring)


def test_a_matrix_of_other_size_without_names_is_refused(ring, tmp_path) -> None:
    np.save(tmp_path / "m.npy", np.ones((7, 180)))
    with pytest.raises(ExchangeError, match="give --planes, --transpose, or names"):
        load(Request(tmp_path / "m.npy", planes="x", unit="m/A"), ring)
