"""Responses in JSON of other programs, and names beside a file."""

import json

import numpy as np
import pytest

from orbitfb.core.errors import ExchangeError
from orbitfb.loco.input.reading import Request, load
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response


@pytest.fixture(scope="module")
def ring() -> Ring:
    return Ring.load()


@pytest.fixture(scope="module")
def nominal(ring: Ring) -> dict[str, np.ndarray]:
    return {"x": response(ring, "x"), "y": response(ring, "y")}


def per_kick(ring: Ring, matrix: np.ndarray, plane: str) -> np.ndarray:
    return matrix / ring.calibration(plane)


def test_json_of_py_aml_and_of_py_sc_is_read(ring, nominal, tmp_path) -> None:
    """Names come once for each plane, with a plane for each; rows are observables, outputs."""
    bpms, correctors = list(ring.names("BPM")), list(ring.names("COR"))
    matrix = np.zeros((360, 361))
    for k, p in enumerate("xy"):
        matrix[180 * k :, 180 * k :][:180, :180] = per_kick(ring, nominal[p], p)
    planes = ["H"] * 180 + ["V"] * 180
    aml = {
        "type": "pyaml.tuning_tools.orbit_response_matrix_data",
        "matrix": matrix.tolist(),
        "variable_names": [*correctors, *correctors, "QH1A_C01"],
        "observable_names": bpms * 2,
        "rf_response": None,
        "variable_planes": [*planes, "Q"],
        "observable_planes": planes,
    }
    other = {"variable_names": "input_names", "observable_names": "output_names",
             "variable_planes": "inputs_plane", "observable_planes": "outputs_plane"}  # fmt: skip
    plain = {k: v for k, v in aml.items() if not k.endswith("planes")}
    plain["matrix"] = matrix[:, :360].tolist()
    plain["variable_names"] = correctors * 2
    for content in (aml, {other.get(k, k): v for k, v in aml.items()}, plain):
        file = tmp_path / "orm.json"
        file.write_text(json.dumps(content))
        loaded = load(Request(file, unit="m/rad"), ring)
        assert loaded.measured.planes == ("x", "y")
        for k, p in enumerate("xy"):
            own = matrix[180 * k :, 180 * k :][:180, :180]
            assert np.allclose(loaded.measured.response[p, p], own)
        left_out = [note for note in loaded.notes if "QH1A_C01" in note]
        assert bool(left_out) == (content is not plain)
    file.write_text(json.dumps(aml | {"variable_planes": planes}))
    with pytest.raises(ExchangeError, match="360 planes for 361 names"):
        load(Request(file, unit="m/rad"), ring)


def test_names_beside_a_file_that_has_none(ring, nominal, tmp_path) -> None:
    np.save(tmp_path / "m.npy", nominal["x"][::-1])
    (tmp_path / "bpms.txt").write_text("\n".join(ring.names("BPM")[::-1]))
    (tmp_path / "correctors.txt").write_text("\n".join(ring.names("COR")))
    given = {"bpm_names": f"@{tmp_path}/bpms.txt", "corrector_names": f"@{tmp_path}/correctors.txt"}
    loaded = load(Request(tmp_path / "m.npy", unit="m/A", planes="x", **given), ring)
    wanted = per_kick(ring, nominal["x"], "x")
    assert np.allclose(loaded.measured.response["x", "x"], wanted)
    with pytest.raises(ExchangeError, match="--bpm-names names: give @FILE"):
        load(Request(tmp_path / "m.npy", unit="m/A", planes="x", bpm_names="names"), ring)
