"""The small second generator: physics against closed forms, effects against their meaning."""

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind import fodo, truth
from benchmarks.blind.records import read_folder


def test_the_orbit_of_a_kick_is_that_of_courant_and_snyder() -> None:
    """Against √(β β′) cos(πν − φ) / (2 sin πν), β of thin FODO lenses in closed form."""
    found = fodo.response(np.zeros(2 * fodo.CELLS))
    half = fodo.HALF_CELL / (2 * fodo.FOCAL)  # sin of half the phase of a cell
    phase = 2 * np.arcsin(half)
    length = 2 * fodo.HALF_CELL
    strong, weak = (length * (1 + sign * half) / np.sin(phase) for sign in (1, -1))
    tune = fodo.CELLS * phase
    lenses = np.arange(2 * fodo.CELLS)
    beta = np.where(lenses % 2 == 0, strong, weak)
    at = lenses * phase / 2  # a FODO cell is symmetric: half its phase from lens to lens
    apart = np.abs(at[:, None] - at)
    wanted = np.sqrt(np.outer(beta, beta)) * np.cos(tune / 2 - apart) / (2 * np.sin(tune / 2))
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9)


def test_a_healthy_record_is_steps_of_the_ground_and_noise() -> None:
    log = fodo.run(fodo.Effect("none"), 1, 1e-6)
    kept = slice(fodo.WARM, None)
    left = np.diff(log["orbit"] - log["setpoint"] @ log["model"].T, axis=0)[kept]
    expected = np.sqrt(2 * fodo.NOISE**2 + fodo.GROUND**2)
    assert 0.9 * expected < np.sqrt(np.mean(left**2)) < 1.5 * expected  # gains of 1 %, too
    error = (log["orbit"] - log["golden"])[fodo.WARM + 200 :]
    assert np.sqrt(np.mean(error**2)) < 10e-6  # the loop is closed


def test_setpoints_sent_again_give_the_same_readings() -> None:
    log = fodo.run(fodo.Effect("none"), 2, 1e-6)
    again = fodo.run(fodo.Effect("none"), 2, 0.0, log["setpoint"])
    np.testing.assert_allclose(again["orbit"], log["orbit"], rtol=0, atol=1e-12)


@pytest.mark.parametrize("word", sorted(fodo.EFFECTS))
def test_every_effect_can_be_seen_and_is_told(word: str, tmp_path: Path) -> None:
    table = tomllib.loads(Path(truth.__file__).with_name("external.toml").read_text())
    assert word in table["known"]
    name = fodo.make(word, 7, tmp_path / "a", tmp_path / "a_truth")
    told = json.loads((tmp_path / "a_truth" / f"{name}.truth.json").read_text())
    (case,) = read_folder(tmp_path / "a")
    if word == "none":
        assert told["difficulty"] == "null"
        assert case.truth.kind == "none"
    else:
        assert told["difficulty"] in ("easy", "medium", "hard")
        assert case.truth.kind == "single"
    first = (tmp_path / "a" / f"{name}.npz").read_bytes()
    fodo.make(word, 7, tmp_path / "b", tmp_path / "b_truth")
    with (
        np.load(tmp_path / "a" / f"{name}.npz") as one,
        np.load(tmp_path / "b" / f"{name}.npz") as two,
    ):
        np.testing.assert_array_equal(one["orbit"], two["orbit"])
        np.testing.assert_array_equal(one["next_orbit"][:-1], one["orbit"][1:])
        np.testing.assert_allclose(
            one["setpoint"][1:], one["setpoint"][:-1] + one["action"][:-1], atol=1e-12
        )
    assert first


def test_every_kind_comes_in_turn(tmp_path: Path) -> None:
    names = fodo.generate(5, tmp_path / "set", 3)
    words = [one.truth.title for one in read_folder(tmp_path / "set")]
    assert names == ["000005", "000006", "000007"]
    assert words == ["no gap", *list(fodo.EFFECTS)[1:3]]


def test_it_imports_nothing_of_what_is_checked() -> None:
    code = "import sys, benchmarks.blind.fodo; print(*(m for m in sys.modules if 'orbitfb' in m))"
    root = Path(fodo.__file__).parents[2]
    told = subprocess.run(
        [sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True
    )
    assert told.stdout.split() == []
