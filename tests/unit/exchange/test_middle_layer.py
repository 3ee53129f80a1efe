"""`Rmat` of the Matlab Middle Layer: devices with numbers, blocks of the planes."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io

from orbitfb.cli.app import app
from orbitfb.core.errors import ExchangeError
from orbitfb.measure.response_file import read_response
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response

RING = Ring.load()


@pytest.fixture
def matrix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    monkeypatch.chdir(tmp_path)
    return response(RING, "x")


def taken(path: str, *arguments: str) -> np.ndarray:
    code = app(["import", "response", path, *arguments], standalone_mode=False)
    assert code in (None, 0), code
    channels = RING.channels("xy" if "xy" in arguments else "x")
    return read_response(Path("response.safetensors"), channels).table.response


def test_its_devices_stand_in_the_order_of_their_numbers(matrix: np.ndarray) -> None:
    mixed = np.random.default_rng(1).permutation(180)
    numbers = np.array([(1 + k // 6, 1 + k % 6) for k in range(180)])
    devices = {"DeviceList": numbers[mixed]}
    one = {"Data": 1e3 * matrix[mixed][:, mixed], "UnitsString": "mm/Ampere"}
    scipy.io.savemat("mixed.mat", {"Rmat": one | {"Monitor": devices, "Actuator": devices}})
    np.testing.assert_allclose(taken("mixed.mat"), matrix)


def test_the_middle_layer_says_where_its_matrix_is(matrix: np.ndarray) -> None:
    one = {"Data": 1e3 * matrix, "UnitsString": "mm/Ampere"}
    scipy.io.savemat("one.mat", {"Rmat": one})
    with pytest.raises(ExchangeError, match="Rmat has one block"):
        taken("one.mat", "--planes", "xy")
    for order in ((), ("--order", "table")):  # its devices have no names, but numbers
        np.testing.assert_allclose(taken("one.mat", *order), matrix)
    scipy.io.savemat("few.mat", {"Rmat": one | {"Data": matrix[1:]}})
    with pytest.raises(ExchangeError, match="the order is not guessed"):
        taken("few.mat")

    vertical = response(RING, "y")
    blocks = np.empty((2, 2), dtype=[("Data", object), ("UnitsString", object)])
    for i, j in np.ndindex(2, 2):
        data = (matrix, vertical)[i] if i == j else np.empty((0, 0))
        blocks[i, j] = (1e3 * data, "mm/Ampere")
    scipy.io.savemat("both.mat", {"Rmat": blocks})
    np.testing.assert_allclose(taken("both.mat"), matrix)
    both = taken("both.mat", "--planes", "xy")
    np.testing.assert_allclose(both[:180, :180], matrix)
    np.testing.assert_allclose(both[180:, 180:], vertical)
    assert not both[:180, 180:].any()
