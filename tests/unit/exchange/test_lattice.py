"""A lattice of Accelerator Toolbox as a table of places, against tracking through it."""

import importlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lazily import Lazy

from orbitfb.core.errors import ExchangeError
from orbitfb.exchange.lattice.table import LatticeRequest, import_lattice
from orbitfb.physics.optics import green
from orbitfb.physics.places import Ring

at = Lazy("at")

CELLS = 8
BEND = 2 * np.pi / (2 * CELLS)


def cell() -> list[Any]:
    """Thick magnets, thick and thin correctors."""
    return [
        at.Quadrupole("QF", 0.3, 2.2),
        at.Drift("D", 0.2),
        at.Monitor("BPM"),
        at.Drift("D", 0.3),
        at.Sextupole("SF", 0.1, 3.0),
        at.Drift("D", 0.2),
        at.Dipole("B1", 1.0, BEND),
        at.Drift("D", 0.3),
        at.Corrector("CM", 0.1, [0.0, 0.0]),
        at.Drift("D", 0.15),
        at.Quadrupole("QD", 0.3, -2.0),
        at.Drift("D", 0.25),
        at.Monitor("BPM"),
        at.Drift("D", 0.3),
        at.Dipole("B2", 1.0, BEND, -0.1),
        at.Drift("D", 0.2),
        at.Corrector("CS", 0.0, [0.0, 0.0]),
        at.Drift("D", 0.3),
    ]


def lattice(elements: list[Any] | None = None, **more: Any) -> at.Lattice:
    elements = elements or [its for _ in range(CELLS) for its in cell()]
    cavity = at.RFCavity("CAV", 0.0, 1e6, 5e8, 64, 3e9)
    made = at.Lattice([*elements, cavity], name="small", energy=3e9, periodicity=1, **more)
    made.disable_6d()
    return made


@pytest.fixture
def request_(tmp_path: Path) -> LatticeRequest:
    return LatticeRequest(
        tmp_path / "ring.json.json", (1e-4, 2e-4), tmp_path / "places.csv", tmp_path / "ring.json"
    )


def imported(request: LatticeRequest, made: at.Lattice | None = None, **more: Any) -> Any:
    request = replace(request, **more)
    at.save_lattice(lattice() if made is None else made, request.file)
    return import_lattice(request)


def tracked_response(made: at.Lattice, plane: str) -> Any:
    row, step = "xy".index(plane), 1e-6
    bpms = [i for i, its in enumerate(made) if its.FamName == "BPM"]
    columns = []
    for its in made:
        if not hasattr(its, "KickAngle"):
            continue
        orbits = []
        for sign in (1, -1):
            its.KickAngle = np.array([sign * step, 0.0] if plane == "x" else [0.0, sign * step])
            _, seen = at.find_sync_orbit(made, dct=0.0, refpts=bpms)
            orbits.append(seen[:, 2 * row])
        its.KickAngle = np.zeros(2)
        columns.append((orbits[0] - orbits[1]) / (2 * step))
    return np.array(columns).T


@pytest.mark.parametrize("suffix", [".m", ".mat", ".json"])
def test_the_table_has_the_response_of_tracking(request_: LatticeRequest, suffix: str):
    answer = imported(request_, file=request_.file.with_suffix(suffix))
    ring = Ring.load(request_.places, request_.parameters)
    assert (answer["BPM"], answer["COR"], answer["QUAD"], answer["SEXT"]) == (16, 16, 16, 8)
    assert answer["bends_with_gradient"] == 8
    made = lattice()
    for plane in ("x", "y"):
        wanted = tracked_response(made, plane)
        found = green(ring, "BPM", "COR", plane)  # type: ignore[arg-type]
        # a kick at the middle of 0.1 m: second order in its length
        assert np.linalg.norm(found - wanted) < 1e-4 * np.linalg.norm(wanted)
    assert ring.parameters.harmonic == 64 and ring.parameters.energy_eV == 3e9
    tunes = made.get_tune()
    assert np.array([ring.tune("x"), ring.tune("y")]) % 1 == pytest.approx(tunes[:2], abs=1e-5)
    assert ring.calibration("y") == pytest.approx(2e-4)
    quadrupoles = ring.strength("QUAD")
    assert quadrupoles[:2] == pytest.approx([2.2 * 0.3, -2.0 * 0.3])
    assert ring.strength("SEXT")[0] == pytest.approx(3.0 * 0.1)


def test_names_and_pvs(request_: LatticeRequest):
    imported(request_, bpm_pv="SR:{name}Pos:{PLANE}-I", setpoint_pv="{name}:{plane}{x}:SP")
    ring = Ring.load(request_.places, request_.parameters)
    assert ring.names("BPM")[0] == "BPM_01" and ring.names("COR")[-1] == "CS_8"
    channels = ring.channels("y")
    assert channels.orbit_pvs[0] == "SR:BPM_01Pos:Y-I"
    assert channels.setpoint_pvs[0] == "CM_1:y{x}:SP"  # other braces stay
    assert channels.readback_pvs[0] == "CM_1:Y:RB"


def test_an_attribute_may_have_the_names(request_: LatticeRequest):
    made = lattice()
    for number, its in enumerate(made):
        its.Device = f"dev{number}"
    file = request_.file.with_suffix(".mat")
    imported(request_, made, file=file, names="Device")
    assert Ring.load(request_.places, request_.parameters).names("BPM")[0] == "dev2"
    for its in made:
        its.Device = "one"
    with pytest.raises(ExchangeError, match=r"Device names .* places not, or several alike: 'one'"):
        imported(request_, made, file=file, names="Device")


def test_families_may_be_named_and_periods_are_unfolded(request_: LatticeRequest):
    made = at.Lattice(cell(), name="cell", energy=3e9, periodicity=CELLS)
    answer = imported(request_, made, correctors="C[MS]", bpms="B?M", harmonic=64)
    assert (answer["BPM"], answer["COR"]) == (16, 16)
    whole = Ring.load(request_.places, request_.parameters)
    assert imported(request_)["nu_x"] == pytest.approx(whole.tune("x"))
    again = Ring.load(request_.places, request_.parameters)
    np.testing.assert_allclose(again.table.beta, whole.table.beta, rtol=1e-6)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"bpms": "PM*"}, 'no element is a BPM; name their families with --bpms, as "BPM'),
        ({"correctors": "none"}, "no element is a COR; name their families with --correctors"),
        ({"calibration": (0.0, 1e-4)}, "makes no ring: .* is a corrector that cannot kick"),
        ({"bpm_pv": "same"}, "makes no ring: .* stands already on line"),
        ({"variable": "OTHER"}, "holds one lattice"),
    ],
)
def test_what_makes_no_ring_is_refused_and_nothing_is_written(
    request_: LatticeRequest, more: Any, words: str
):
    with pytest.raises(ExchangeError, match=words):
        imported(request_, **{"file": request_.file.with_suffix(".m")} | more)
    assert not request_.places.exists() and not request_.parameters.exists()


def test_files_that_are_no_lattice_are_refused(request_: LatticeRequest, tmp_path: Path):
    for name, content, words in (
        ("a.txt", "", "a lattice is a file .m, .mat, .json of pyAT"),
        ("a.json", json.dumps({"a": 1}), "pyAT does not take it"),
        ("a.mat", "no MATLAB", "pyAT does not take it"),
    ):
        (tmp_path / name).write_text(content)
        with pytest.raises(ExchangeError, match=words):
            import_lattice(replace(request_, file=tmp_path / name))
    with pytest.raises(ExchangeError, match="there is no such file"):
        import_lattice(replace(request_, file=tmp_path / "b.mat"))


def test_a_variable_that_is_not_there_is_told(request_: LatticeRequest):
    with pytest.raises(ExchangeError, match=r"pyAT does not take it.*--variable"):
        imported(request_, file=request_.file.with_suffix(".mat"), variable="OTHER")


def test_without_a_cavity_the_harmonic_number_is_asked_for(request_: LatticeRequest):
    made = at.Lattice([its for _ in range(CELLS) for its in cell()], energy=3e9, periodicity=1)
    with pytest.raises(ExchangeError, match="give it with --harmonic"):
        imported(request_, made)


def test_an_unstable_lattice_is_refused(request_: LatticeRequest):
    made = lattice()
    for its in made:
        if its.FamName == "QF":
            its.PolynomB[1] = 40.0
    with pytest.raises(ExchangeError, match=r"no stable|finds no optics"):
        imported(request_, made)


def test_without_pyat_it_says_what_to_install(
    request_: LatticeRequest, monkeypatch: pytest.MonkeyPatch
):
    def missing(name: str) -> Any:
        raise ImportError(name)

    at.save_lattice(lattice(), request_.file)
    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(ExchangeError, match=r"pip install 'orbitfb\[lattice\]'"):
        import_lattice(request_)
