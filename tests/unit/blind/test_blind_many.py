"""Small rings of many kinds: their records are what they say, and come again."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind import many
from benchmarks.blind.many import HEALTHY, USUAL
from benchmarks.blind.records import read_folder

pytestmark = pytest.mark.nightly


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("many") / "set"
    many.generate(3, out, None)
    return out


def record(folder: Path, name: str) -> dict[str, np.ndarray]:
    with np.load(folder / f"{name}.npz") as file:
        return dict(file)


def test_there_is_every_machine_and_every_effect(folder: Path) -> None:
    cases = read_folder(folder)
    healthy = [one for one in cases if one.name.endswith("-healthy")]
    assert len(healthy) == len(HEALTHY)
    assert len(cases) == len(HEALTHY) + len(USUAL) * len(many.FAULTS)
    assert [one.truth.kind for one in healthy].count("none") == len(HEALTHY) - 1
    assert {one.truth.kind for one in cases if one not in healthy} == {"single"}


def test_healthy_ones_have_no_fault(tmp_path: Path) -> None:
    names = many.generate(3, tmp_path, None, healthy=True)
    assert names == [f"{machine}-healthy" for machine in many.HEALTHY]


def test_a_record_comes_again(folder: Path, tmp_path: Path) -> None:
    (name,) = many.generate(3, tmp_path / "again", 1)
    one, two = record(folder, name), record(tmp_path / "again", name)
    np.testing.assert_array_equal(one["orbit"], two["orbit"])


def test_steps_of_the_readings_are_those_of_the_machine(folder: Path) -> None:
    """Healthy: what the model leaves of a step is noise, twice, and ground; gains are 1 % off."""
    its = record(folder, "no-steering-healthy")
    left = np.diff(its["orbit"], axis=0) - np.diff(its["setpoint"], axis=0) @ its["model_R"].T
    machine = HEALTHY["no-steering"]
    wanted = 1e3 * np.sqrt(2.0 * machine.noise**2 + machine.ground**2)
    assert np.sqrt(np.mean(left**2)) == pytest.approx(wanted, rel=0.1)


def test_readings_are_recorded_as_they_say(folder: Path) -> None:
    def repeats(name: str) -> np.ndarray:
        return np.diff(record(folder, name)["orbit"], axis=0) == 0.0

    assert repeats("held-healthy").mean() == pytest.approx(0.3, abs=0.02)
    whole = repeats("held-orbits-healthy")
    assert whole.all(axis=1).mean() == whole.mean() == pytest.approx(0.4, abs=0.05)
    assert np.isnan(record(folder, "invalid-healthy")["orbit"]).mean() == pytest.approx(
        0.003, rel=0.3
    )
    assert len(record(folder, "lost-rows-healthy")["t"]) == 870
    assert record(folder, "few-correctors-healthy")["model_R"].shape == (20, 14)
    coarse = record(folder, "coarse-healthy")["orbit"] / 2e-4
    np.testing.assert_allclose(coarse, np.round(coarse), atol=1e-6)
