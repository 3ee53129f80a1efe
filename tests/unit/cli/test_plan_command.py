"""`orbitfb diagnose plan`: what a machine executes is planned from an intact record only."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from orbitfb.cli.app import app
from orbitfb.core.errors import ConfigError
from tests.unit.records import record_files


def run(*arguments):
    return CliRunner().invoke(app, ["diagnose", "plan", *map(str, arguments)])


@pytest.fixture(scope="module")
def made():
    return record_files.arrays(ticks=300, dither=1e-4)


def in_metres(made):
    return {"model_R": 1e-3 * made["model_R"]}


def in_micrometres(made):
    return {name: 1e3 * made[name] for name in ("orbit", "next_orbit")}


def turned(made):
    return {"model_R": -made["model_R"]}


def transposed(made):
    return {"model_R": made["model_R"].T.copy()}


def frozen(made):
    return {name: np.full_like(made[name], 0.1) for name in ("orbit", "next_orbit")}


@pytest.mark.parametrize("spoil", [in_metres, in_micrometres, turned, transposed, frozen])
def test_nothing_is_planned_from_a_record_that_is_not_intact(made, tmp_path, spoil):
    record = record_files.save(tmp_path / "record.npz", made | spoil(made))
    out = tmp_path / "excite.toml"
    result = run(record, "--for", "corrector-gain", "--out", out)
    assert result.exit_code == 3, result.output
    assert "failure: " in result.stderr
    assert "nothing was planned" in result.stderr
    assert not out.exists()


@pytest.mark.nightly
def test_an_intact_record_gets_its_plan(made, tmp_path):
    record = record_files.save(tmp_path / "record.npz", made)
    out = tmp_path / "excite.toml"
    result = run(record, "--for", "corrector-lag", "--out", out, "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["file"] == str(out)
    assert out.read_text(encoding="utf-8").startswith("# To see corrector-lag")


def test_planes_that_are_not_those_of_the_model_are_refused(made, tmp_path):
    record = record_files.save(tmp_path / "record.npz", made)
    result = run(record, "--planes", "y", "--out", tmp_path / "excite.toml")
    assert isinstance(result.exception, ConfigError)
    assert "--planes y" in str(result.exception)


def test_an_effect_is_not_told_from_itself(made, tmp_path):
    record = record_files.save(tmp_path / "record.npz", made)
    both = ("--for", "corrector-lag", "--against", "corrector-lag")
    result = run(record, *both, "--out", tmp_path / "excite.toml")
    assert isinstance(result.exception, ConfigError)
    assert "--against corrector-lag" in str(result.exception)


@pytest.mark.parametrize("name", ["", "not-there/excite.toml", "excite.csv", "excite"])
def test_a_file_that_cannot_be_is_told_before_the_work(tmp_path, name):
    result = run(tmp_path / "no-record.npz", "--out", tmp_path / name)
    assert "--out" in str(result.exception)
