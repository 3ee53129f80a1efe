"""A lattice of Accelerator Toolbox becomes a ring, and a loop closes on it."""

import csv
import json
from itertools import cycle
from pathlib import Path

import pytest
from free_ports import free_port
from lazily import Lazy
from service_process import orbitfb

at = Lazy("at")

pytestmark = pytest.mark.system


def save(path: Path) -> None:
    """A small ring, as somebody else may have it."""
    cells = 8
    cell = [
        at.Quadrupole("QF", 0.3, 2.2), at.Drift("D", 0.2), at.Monitor("BPM"), at.Drift("D", 0.6),
        at.Dipole("B", 1.0, 3.141592653589793 / cells), at.Drift("D", 0.3),
        at.Corrector("COR", 0.1, [0.0, 0.0]), at.Drift("D", 0.15), at.Quadrupole("QD", 0.3, -2.0),
        at.Drift("D", 0.25), at.Monitor("BPM"), at.Drift("D", 0.3),
        at.Dipole("B", 1.0, 3.141592653589793 / cells), at.Drift("D", 0.4),
        at.Corrector("COR", 0.1, [0.0, 0.0]), at.Drift("D", 0.2),
    ]  # fmt: skip
    at.save_lattice(at.Lattice(cell, name="cell", energy=3e9, periodicity=cells), path)


def as_devices_are(places: Path) -> None:
    """Not every supply tells its current, and BPMs are of several makers."""
    with places.open(newline="") as file:
        rows = [*csv.DictReader(file)]
    for row in [row for row in rows if row["kind"] == "COR"][::2]:
        row["rb_x"] = row["rb_y"] = ""
    units = cycle(("nm", "um", "mm", "m"))
    for row in rows:
        row["unit"] = next(units) if row["kind"] == "BPM" else ""
    with places.open("w", newline="") as file:
        writer = csv.DictWriter(file, [*rows[0]])
        writer.writeheader()
        writer.writerows(rows)


def test_a_loop_closes_on_a_ring_that_was_a_lattice(tmp_path: Path):
    save(tmp_path / "cell.json")
    made = orbitfb(
        "import", "lattice", tmp_path / "cell.json", "--calibration", 1e-4, "--harmonic", 64,
        "--out", tmp_path / "places.csv", "--parameters", tmp_path / "ring.json", "--json",
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    assert json.loads(made.stdout)["BPM"] == 16
    as_devices_are(tmp_path / "places.csv")
    config = tmp_path / "config.toml"
    config.write_text('[ring]\nplaces = "places.csv"\nparameters = "ring.json"\n')
    done = orbitfb(
        "run", "--ioc", "sim", "--config", config, "--data", tmp_path / "data", "--port",
        free_port(), "--metrics-port", 0, "--duration", 12, "--summary", tmp_path / "summary.json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["state"] == "CLOSED" and summary["bpms"] == 16
    assert summary["roll_backs"] == 0 and summary["reason"] == ""
    rms = summary["orbit_rms_um"]  # the last 10 s are all of it: the first second counts, too
    assert rms["last_10s"] < 0.5 * rms["first"]
