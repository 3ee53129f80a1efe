"""A small ring of thin magnets, tracked by accelerator-toolbox, and the places table of it."""

import csv
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from lazily import Lazy

from orbitfb.physics.places import Ring
from orbitfb.physics.table import COLUMNS

at = Lazy("at")

CELLS = 8
CALIBRATION = (4e-5, 6e-5)


@dataclass
class TrackedRing:
    """The oracle: the same ring as a lattice to track through and as a table of places."""

    lattice: "at.Lattice"
    ring: Ring
    bpms: list[int]
    correctors: list[int]
    quadrupoles: list[int]
    sextupoles: list[int]

    def orbit(self, dct: float = 0.0) -> np.ndarray:
        """Closed orbit at the BPMs at fixed RF frequency, rows x and y."""
        _, orbits = at.find_sync_orbit(self.lattice, dct=dct, refpts=self.bpms)
        return orbits[:, [0, 2]].T

    def kick(self, corrector: int, kick_x: float, kick_y: float) -> None:
        self.lattice[self.correctors[corrector]].KickAngle = [kick_x, kick_y]

    def response(self, plane: str, step: float = 1e-6) -> np.ndarray:
        """Orbit per kick by central differences, shape (n, m) [m/rad]."""
        row = "xy".index(plane)
        columns = []
        for j in range(len(self.correctors)):
            orbits = []
            for sign in (1, -1):
                kicks = [0.0, 0.0]
                kicks[row] = sign * step
                self.kick(j, *kicks)
                orbits.append(self.orbit()[row])
            self.kick(j, 0.0, 0.0)
            columns.append((orbits[0] - orbits[1]) / (2 * step))
        return np.array(columns).T


def _lattice(sextupoles: np.ndarray) -> at.Lattice:
    elements: list[at.Element] = []
    bend = 2 * np.pi / (2 * CELLS)

    def drift(length: float) -> at.Drift:
        return at.Drift("D", length)

    for cell in range(CELLS):
        # unequal drifts, so that no symmetry hides a mistake
        a = 0.3 + 0.02 * cell
        elements += [
            at.ThinMultipole(f"QF{cell}", [0, 0], [0, 0.75]),
            drift(0.2),
            at.Monitor(f"P1{cell}"),
            drift(a),
            at.ThinMultipole(f"S1{cell}", [0, 0, 0], [0, 0, sextupoles[2 * cell]]),
            drift(0.2),
            at.Dipole(f"B1{cell}", 1.0, bend),
            drift(0.3),
            at.Corrector(f"C1{cell}", 0.0, [0.0, 0.0]),
            drift(0.25),
            at.ThinMultipole(f"QD{cell}", [0, 0], [0, -0.72]),
            drift(0.25),
            at.Monitor(f"P2{cell}"),
            drift(0.6 - a),
            at.ThinMultipole(f"S2{cell}", [0, 0, 0], [0, 0, sextupoles[2 * cell + 1]]),
            drift(0.2),
            at.Dipole(f"B2{cell}", 1.0, bend),
            drift(0.3),
            at.Corrector(f"C2{cell}", 0.0, [0.0, 0.0]),
            drift(0.1 + 0.01 * cell),
        ]
    lattice = at.Lattice(elements, name="small", energy=3e9, periodicity=1)
    lattice.disable_6d()
    return lattice


def _kind(element: at.Element) -> str | None:
    name = element.FamName
    return {"P": "BPM", "C": "COR", "Q": "QUAD", "S": "SEXT"}.get(name[0])


def _cells(element: at.Element, kind: str) -> dict[str, object]:
    name = element.FamName
    if kind == "COR":
        return {
            "cal_x_rad_per_A": CALIBRATION[0],
            "cal_y_rad_per_A": CALIBRATION[1],
            "pv_x": f"{name}:X",
            "pv_y": f"{name}:Y",
            "rb_x": f"{name}:XRB",
            "rb_y": f"{name}:YRB",
        }
    if kind == "BPM":
        return {"pv_x": f"{name}:X", "pv_y": f"{name}:Y"}
    return {"length_m": 0.0, "strength": element.PolynomB[1 if kind == "QUAD" else 2]}


def _table(lattice: at.Lattice) -> list[dict[str, object]]:
    everywhere = np.arange(len(lattice) + 1)
    _, _, optics = at.get_optics(lattice, everywhere)
    s = lattice.get_s_pos(everywhere)
    rows = []
    for i, element in enumerate(lattice):
        kind = _kind(element)
        if kind is None:
            continue
        rows.append(
            dict.fromkeys(COLUMNS, "")
            | {
                "name": element.FamName,
                "kind": kind,
                "s_m": repr(float(s[i])),
                "beta_x_m": repr(float(optics.beta[i, 0])),
                "beta_y_m": repr(float(optics.beta[i, 1])),
                "mu_x_2pi": repr(float(optics.mu[i, 0] / (2 * np.pi))),
                "mu_y_2pi": repr(float(optics.mu[i, 1] / (2 * np.pi))),
                "eta_x_m": repr(float(optics.dispersion[i, 0])),
            }
            | _cells(element, kind)
        )
    return rows


def _ring(lattice: at.Lattice, folder: Path) -> Ring:
    with (folder / "places.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(_table(lattice))
    # only with all places in between does the phase advance count whole turns
    optics = at.get_optics(lattice, np.arange(len(lattice) + 1))[2]
    tunes = optics.mu[-1] / (2 * np.pi)
    document = {
        "energy_eV": lattice.energy,
        "circumference_m": lattice.circumference,
        "harmonic": 40,
        "nu_x": float(tunes[0]),
        "nu_y": float(tunes[1]),
        "alpha_c": float(lattice.get_mcf()),
    }
    (folder / "ring.json").write_text(json.dumps(document))
    return Ring.load(folder / "places.csv", folder / "ring.json")


def _tracked(folder: Path, sextupoles: np.ndarray) -> TrackedRing:
    lattice = _lattice(sextupoles)

    def where(kind: str) -> list[int]:
        return [i for i, element in enumerate(lattice) if _kind(element) == kind]

    return TrackedRing(
        lattice,
        _ring(lattice, folder),
        bpms=where("BPM"),
        correctors=where("COR"),
        quadrupoles=where("QUAD"),
        sextupoles=where("SEXT"),
    )


@pytest.fixture
def tracked(tmp_path: Path) -> TrackedRing:
    """A fresh small ring, without sextupole strength."""
    return _tracked(tmp_path, np.zeros(2 * CELLS))


@pytest.fixture
def tracked_with_sextupoles(tmp_path: Path) -> TrackedRing:
    """The same ring with strong sextupoles of either sign."""
    return _tracked(tmp_path, 3 * np.random.default_rng(1).standard_normal(2 * CELLS))


@pytest.fixture(scope="session")
def ring() -> Ring:
    """The default ring."""
    return Ring.load()
