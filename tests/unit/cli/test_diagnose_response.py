"""`orbitfb diagnose RESPONSE`: files that it writes, and which files are responses."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from orbitfb.cli.app import app
from orbitfb.cli.diagnosis.response import is_response
from orbitfb.effects.files import read_effects
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response, seeded_gradient_errors


@pytest.fixture(scope="module")
def measured(tmp_path_factory) -> Path:
    """A response of a part of the default ring with a weak BPM and noise."""
    ring, rng = Ring.load(), np.random.default_rng(2)
    matrix = response(ring, "x")[::4, ::4]
    scatter = 1 + 0.01 * rng.standard_normal(matrix.shape[0])
    scatter[6] = 0.6
    matrix = scatter[:, None] * matrix
    matrix = matrix + 2e-6 * rng.standard_normal(matrix.shape)
    path = tmp_path_factory.mktemp("response") / "m.csv"
    lines = [",".join(["R [m/A]", *ring.names("COR")[::4]])]
    for name, row in zip(ring.names("BPM")[::4], matrix, strict=True):
        lines.append(",".join([name, *map(repr, map(float, row))]))
    path.write_text("\n".join(lines) + "\n")
    return path


def test_it_names_the_device_and_writes_what_can_be_used(measured: Path, tmp_path: Path) -> None:
    out = tmp_path / "d"
    told = CliRunner().invoke(
        app, ["diagnose", str(measured), "--planes", "x", "--out", str(out), "--json"]
    )
    assert told.exit_code == 0, told.output
    answer = json.loads((out / "diagnosis.json").read_text())
    assert json.loads(told.stdout) == answer
    name = Ring.load().names("BPM")[24]
    assert answer["state"] == "named"
    assert [its["places"] for its in answer["findings"]] == [[f"{name}:x"]]
    effects = read_effects(out / "effect.toml")
    assert [(its.id, its.names, its.planes) for its in effects] == [("bpm-gain", (name,), "x")]
    assert effects[0].values["gain"] == pytest.approx(-0.4, abs=0.02)
    report = (out / "report.html").read_text()
    assert report.count("<img") == 3
    assert name in report
    assert (out / "bpms.csv").read_text().splitlines()[0].startswith("name,plane,s_m,gain")
    assert len((out / "corrections.csv").read_text().splitlines()) == 301
    # the fitted response is one that the product reads
    from orbitfb.loco.input.reading import Request, load

    assert load(Request(out / "fitted.csv"), Ring.load()).measured.planes == ("x",)


@pytest.mark.nightly
def test_the_terminal_says_residuals_and_growth(measured: Path, tmp_path: Path) -> None:
    told = CliRunner().invoke(
        app, ["diagnose", str(measured), "--planes", "x", "--noise", "0.4um", "--out",
              str(tmp_path / "d")],
    )  # fmt: skip
    assert told.exit_code == 0, told.output
    assert "named: BPM" in told.stdout
    assert "x by x: table" in told.stdout
    assert "an SVD loop on the optics" in told.stdout


@pytest.mark.parametrize(
    ("name", "parts", "expected"),
    [
        ("m.csv", None, True),
        ("m.npz", ("response", "bpms"), True),
        ("m.npz", ("orbit", "setpoints", "response"), False),
        ("m.npz", ("orbit", "setpoints"), False),
        ("m.h5", None, False),
    ],
)
def test_records_and_responses_are_told_apart(tmp_path, name, parts, expected) -> None:
    path = tmp_path / name
    if parts:
        np.savez(path, **{part: np.zeros(2) for part in parts})
    else:
        path.write_text("x")
    assert is_response(path) is expected


def test_a_noise_without_a_unit_of_length_is_refused(measured: Path, tmp_path: Path) -> None:
    told = CliRunner().invoke(
        app, ["diagnose", str(measured), "--noise", "3V", "--out", str(tmp_path / "d")]
    )
    assert told.exit_code != 0
    assert "--noise" in str(told.exception)


def test_a_pair_of_measured_and_model_is_compared(tmp_path: Path) -> None:
    """The model has other optics than the table, another order and one corrector less."""
    ring = Ring.load()
    errors = seeded_gradient_errors(ring, 0.03, 5)
    own = response(ring, "x", errors)[::4, ::4]
    rows, columns = ring.names("BPM")[::4], ring.names("COR")[::4]
    rng = np.random.default_rng(3)
    data = own + 2e-6 * rng.standard_normal(own.shape)
    data[6] *= 0.6
    np.savez(tmp_path / "data.npz", response=data, bpms=rows, correctors=columns, units="m/A")
    np.savez(
        tmp_path / "model.npz", response=own[::-1, 1:], bpms=rows[::-1], correctors=columns[1:],
        units="m/A",
    )  # fmt: skip
    out = tmp_path / "d"
    told = CliRunner().invoke(
        app, ["diagnose", str(tmp_path / "data.npz"), "--planes", "x", "--model",
              str(tmp_path / "model.npz"), "--out", str(out)],
    )  # fmt: skip
    assert told.exit_code == 0, told.output
    answer = json.loads((out / "diagnosis.json").read_text())
    assert [its["places"] for its in answer["findings"]] == [[f"{rows[6]}:x"]]
    assert "the model is that of model.npz" in answer["notes"]
    assert max(abs(its["relative"]) for its in answer["quadrupoles"]) < 1e-3
    assert answer["correctors"][0]["calibration"] is None  # the model does not know it
    assert answer["blocks"][0]["raw"] < 0.1  # the weak BPM alone
