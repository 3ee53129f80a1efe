"""Formats of measured responses, and devices that a table lacks or a plane has not."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from orbitfb.core.errors import ExchangeError
from orbitfb.loco.input.reading import Request, load
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


def test_repeats_give_the_mean_and_its_noise(ring, nominal, tmp_path) -> None:
    rng, noise = np.random.default_rng(3), 1e-5
    its = nominal["x"] + noise * rng.standard_normal((4, 180, 180))
    its[2, 7, 9] = np.nan
    np.savez(
        tmp_path / "m.npz", response=its, bpms=ring.names("BPM"), correctors=ring.names("COR"),
        units="m/A",
    )  # fmt: skip
    measured = load(Request(tmp_path / "m.npz", planes="x"), ring).measured
    mean = per_kick(ring, np.nanmean(its, axis=0), "x")
    assert np.allclose(measured.response["x", "x"], mean)
    wanted = per_kick(ring, np.full((180, 180), noise / 2), "x")
    assert np.allclose(np.median(measured.sigma["x", "x"] / wanted), 1.0, rtol=0.02)
    assert np.ptp(measured.sigma["x", "x"] / wanted) < 0.8


def test_masked_devices_do_not_count_and_unknown_ones_are_told(ring, nominal, tmp_path) -> None:
    np.save(tmp_path / "m.npy", nominal["x"])
    bpm, corrector = ring.names("BPM")[3], ring.names("COR")[5]
    request = Request(tmp_path / "m.npy", "m/A", "x", masked=(f"{bpm}:x", corrector))
    loaded = load(request, ring)
    holes = np.isnan(loaded.measured.response["x", "x"])
    assert holes[3].all()
    assert holes[:, 5].all()
    assert holes.sum() == 180 + 180 - 1
    assert f"left out as asked: {bpm}:x, {corrector}" in loaded.notes
    with pytest.raises(ExchangeError, match=f"did you mean.*{bpm}"):
        load(Request(tmp_path / "m.npy", "m/A", "x", masked=(bpm.lower(),)), ring)


def test_the_column_of_the_rf_is_read_from_a_table(ring, nominal, tmp_path) -> None:
    np.save(tmp_path / "m.npy", nominal["x"])
    eta, names = ring.table.dispersion[ring.places("BPM")], ring.names("BPM")
    lines = [f"{name},{1e3 * value}" for name, value in zip(names, eta, strict=True)]
    (tmp_path / "eta.csv").write_text("\n".join(["bpm,dispersion [mm]", *lines[4:]]))
    request = Request(tmp_path / "m.npy", "m/A", "x", dispersion=tmp_path / "eta.csv")
    loaded = load(request, ring)
    assert loaded.measured.dispersion == pytest.approx([*[np.nan] * 4, *eta[4:]], nan_ok=True)
    assert "dispersion of 176 BPMs is fitted with it" in loaded.notes
    (tmp_path / "other.csv").write_text("bpm,dispersion [mm]\nA,1\nB,2\n")
    with pytest.raises(ExchangeError, match="none of its 2 names"):
        load(Request(tmp_path / "m.npy", "m/A", "x", dispersion=tmp_path / "other.csv"), ring)


def test_loco_s_step_of_the_rf_is_the_dispersion(ring, nominal, tmp_path) -> None:
    orbits = np.zeros((360, 360))
    for k, p in enumerate("xy"):
        own = slice(180 * k, 180 * (k + 1))
        orbits[own, own] = per_kick(ring, nominal[p], p) * 0.1e-3 * 1e3
    kicks, eta = np.full((180, 1), 0.1), ring.table.dispersion[ring.places("BPM")]
    step, frequency = 1000.0, 5e8
    orbit = -eta / ring.parameters.alpha_c * step / frequency * 1e3
    loco = {
        "M": orbits, "BPMSTD": np.full((360, 1), 1e-3), "DeltaRF": step, "RF": frequency,
        "Eta": np.concatenate([orbit, np.zeros(180)]),
    }  # fmt: skip
    savemat(tmp_path / "l.mat", {"LocoMeasData": loco,
                                 "CMData": {"HCMKicks": kicks, "VCMKicks": kicks}})  # fmt: skip
    assert load(Request(tmp_path / "l.mat"), ring).measured.dispersion == pytest.approx(eta)


@pytest.fixture(scope="module")
def sparse() -> Ring:
    """The default ring in which every other corrector has no PV and no calibration in y."""
    text = Ring.load()
    table = text.table
    calibration = table.calibration.copy()
    cor = text.places("COR")
    calibration[1, cor[::2]] = np.nan
    pv = tuple(
        tuple("" if row and i in cor[::2] else its for i, its in enumerate(pvs))
        for row, pvs in enumerate(table.pv)
    )
    return Ring(replace(table, calibration=calibration, pv=pv), text.parameters)


def test_without_names_each_plane_has_its_own_devices(sparse, tmp_path) -> None:
    ring = sparse
    rows, columns = [180, 180], [180, 90]
    stacked = np.zeros((sum(rows), sum(columns)))
    stacked[:180, :180], stacked[180:, 180:] = 1.0, 2.0
    np.save(tmp_path / "m.npy", stacked)
    measured = load(Request(tmp_path / "m.npy", "m/rad"), ring).measured
    assert {p: len(its) for p, its in measured.correctors.items()} == {"x": 180, "y": 90}
    assert measured.correctors["y"].tolist() == ring.places("COR", "y").tolist()


def test_a_matrix_whose_rows_are_correctors_is_told(ring, nominal, tmp_path) -> None:
    file = csv(tmp_path / "m.csv", ring.names("COR"), ring.names("BPM"), nominal["x"].T)
    with pytest.raises(ExchangeError, match=r"rows of values are correctors.*give --transpose"):
        load(Request(file, planes="x"), ring)
    assert load(Request(file, planes="x", transpose=True), ring).measured.planes == ("x",)
    right = csv(tmp_path / "r.csv", ring.names("BPM"), ring.names("COR"), nominal["x"])
    with pytest.raises(ExchangeError, match="leave --transpose out"):
        load(Request(right, planes="x", transpose=True), ring)


@pytest.mark.parametrize(
    ("sigma", "told"), [(np.ones((3, 3)), "shape .3, 3."), (-np.ones((180, 180)), "32400 negative")]
)
def test_a_sigma_that_is_none_is_refused(ring, nominal, tmp_path, sigma, told: str) -> None:
    np.savez(
        tmp_path / "m.npz", response=nominal["x"], bpms=ring.names("BPM"),
        correctors=ring.names("COR"), units="m/A", sigma=sigma,
    )  # fmt: skip
    with pytest.raises(ExchangeError, match=told):
        load(Request(tmp_path / "m.npz", planes="x"), ring)


def test_a_corrector_that_a_plane_lacks_is_left_out_and_told(sparse, nominal, tmp_path) -> None:
    names = sparse.names("COR")
    file = csv(tmp_path / "m.csv", sparse.names("BPM"), names, nominal["y"])
    loaded = load(Request(file, planes="y"), sparse)
    assert loaded.measured.correctors["y"].tolist() == sparse.places("COR", "y").tolist()
    assert np.isfinite(loaded.measured.response["y", "y"]).all()
    assert loaded.notes == (
        f"90 correctors that are of the other plane are left out: {', '.join(names[0:12:2])} …",
    )
    # a name says its plane where there is but one
    x = load(Request(csv(tmp_path / "x.csv", sparse.names("BPM"), names, nominal["x"]), planes="x"),
             sparse)  # fmt: skip
    assert len(x.measured.correctors["x"]) == 180
