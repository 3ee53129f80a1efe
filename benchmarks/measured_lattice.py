"""A LOCO file of the Matlab Middle Layer: its lattice as a places table, its matrix as measured.

Needs accelerator-toolbox (of the `dev` extra) for the optics of the lattice.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from orbitfb.loco.measured import Measured
from orbitfb.physics.parameters import RingParameters
from orbitfb.physics.places import Plane, Ring
from orbitfb.physics.table import PlacesTable

_APART = 1e-6
"""Two devices at one place are told apart by this [m]; no optics change over it."""


@dataclass(frozen=True, slots=True, eq=False)
class LocoFile:
    """What a LOCO file holds.

    Args:
        ring: Of its lattice, with all devices.
        measured: Its matrix [m/rad].
        laboratory: Gains of BPMs and calibrations of correctors of the laboratory's own fit, by
            `gain:x`, `calibration:y`, …
        noise: Of a reading, per plane [m].
        kick: Of every corrector, per plane [rad].
    """

    ring: Ring
    measured: Measured
    laboratory: dict[str, np.ndarray]
    noise: dict[Plane, np.ndarray]
    kick: dict[Plane, np.ndarray]


def read(path: Path, slices: int = 1) -> LocoFile:
    """Read a LOCO file."""
    data = loadmat(path, struct_as_record=False, squeeze_me=True)
    bpm, corrector = np.ravel(data["BPMData"]), np.ravel(data["CMData"])
    loco, ring_data = data["LocoMeasData"], data["RINGData"]
    first = bpm[0]
    index = np.ravel(first.BPMIndex)
    bpms = {
        "x": index[np.ravel(first.HBPMIndex) - 1] - 1,
        "y": index[np.ravel(first.VBPMIndex) - 1] - 1,
    }
    correctors = {
        "x": np.ravel(corrector[0].HCMIndex) - 1,
        "y": np.ravel(corrector[0].VCMIndex) - 1,
    }
    ring, where = _ring(ring_data, bpms, correctors, slices)
    kick = {
        "x": 1e-3 * np.ravel(corrector[0].HCMKicks).astype(float),
        "y": 1e-3 * np.ravel(corrector[0].VCMKicks).astype(float),
    }
    whole = 1e-3 * np.asarray(loco.M, dtype=float) / np.concatenate([kick["x"], kick["y"]])
    std = 1e-3 * np.ravel(loco.BPMSTD).astype(float) * np.sqrt(2.0)
    split_rows, split_columns = len(bpms["x"]), len(kick["x"])
    part = {"x": slice(0, split_rows), "y": slice(split_rows, None)}
    columns = {"x": slice(0, split_columns), "y": slice(split_columns, None)}
    response, sigma = {}, {}
    for read_plane in ("x", "y"):
        for driven in ("x", "y"):
            block = whole[part[read_plane], columns[driven]]
            response[read_plane, driven] = np.where(block == 0.0, np.nan, block)
            sigma[read_plane, driven] = std[part[read_plane], None] / np.abs(kick[driven])
    last = bpm[-1]
    laboratory = {
        "gain:x": np.ravel(last.HBPMGain).astype(float),
        "gain:y": np.ravel(last.VBPMGain).astype(float),
        "calibration:x": np.ravel(corrector[-1].HCMKicks) * 1e-3 / kick["x"],
        "calibration:y": np.ravel(corrector[-1].VCMKicks) * 1e-3 / kick["y"],
    }
    measured = Measured(
        {p: np.array([where["B", int(i)] for i in bpms[p]]) for p in ("x", "y")},
        {p: np.array([where["C", int(j)] for j in correctors[p]]) for p in ("x", "y")},
        response,
        sigma,
    )
    return LocoFile(
        ring, measured, laboratory, {p: std[part[p]] / np.sqrt(2.0) for p in part}, kick
    )


def _element(cell: Any) -> Any:
    import at

    get = lambda key, other=0.0: getattr(cell, key, other)  # noqa: E731
    length, name = float(get("Length") or 0.0), str(cell.FamName)
    angle = float(np.ravel(get("BendingAngle"))[0]) if np.size(get("BendingAngle")) else 0.0
    second = np.ravel(get("PolynomB", np.zeros(2))).astype(float)
    k = float(second[1]) if second.size > 1 else 0.0
    if not k and np.size(get("K")):
        k = float(np.ravel(get("K"))[0])
    if angle:
        return at.Dipole(
            name, length, angle, k,
            EntranceAngle=float(get("EntranceAngle")), ExitAngle=float(get("ExitAngle")),
            NumIntSteps=10,
        )  # fmt: skip
    if k and length:
        return at.Quadrupole(name, length, k, NumIntSteps=10)
    return at.Drift(name, length) if length else at.Marker(name)


def _ring(
    ring_data: Any, bpms: dict[str, np.ndarray], correctors: dict[str, np.ndarray], slices: int
) -> tuple[Ring, dict[tuple[str, int], int]]:
    import at

    cells = np.ravel(ring_data.Lattice)
    energy = float(getattr(cells[-1], "Energy", 3e9))
    wanted: list[tuple[str, int]] = [("B", int(i)) for i in set(bpms["x"]) | set(bpms["y"])]
    wanted += [("C", int(i)) for i in set(correctors["x"]) | set(correctors["y"])]
    own = {index: kind for kind, index in wanted}
    parts, marks, strengths = [], {}, {}
    for number, cell in enumerate(cells):
        element = _element(cell)
        if isinstance(element, at.Quadrupole):
            pieces = element.divide([1 / (2 * slices)] * (2 * slices))
            for piece in range(slices):
                parts.append(pieces[2 * piece])
                marks["Q", number * 100 + piece] = len(parts)
                strengths[number * 100 + piece] = element.K * element.Length / slices
                parts.append(pieces[2 * piece + 1])
        elif number in own:
            if element.Length:
                half = element.divide([0.5, 0.5])
                parts.append(half[0])
                marks[own[number], number] = len(parts)
                parts.append(half[1])
            else:
                marks[own[number], number] = len(parts)
                parts.append(element)
        else:
            parts.append(element)
    lattice = at.Lattice(parts, energy=energy, periodicity=1)
    data = lattice.get_optics(refpts=range(len(parts) + 1), get_chrom=False)
    optics, total = data[2], data[1]
    order = sorted(marks, key=lambda key: (marks[key], key))
    names, kinds, rows, s_before = [], [], [], -1.0
    where: dict[tuple[str, int], int] = {}
    strength, calibration = [], []
    end = optics[-1].mu / (2 * np.pi)
    for place, key in enumerate(order):
        its = optics[marks[key]]
        s = max(float(its.s_pos), s_before + _APART)
        s_before = s
        where[key] = place
        names.append(f"{key[0]}{key[1]}")
        kinds.append({"B": "BPM", "C": "COR", "Q": "QUAD"}[key[0]])
        rows.append((s, *its.beta, *its.mu, float(its.dispersion[0])))
        strength.append(strengths.get(key[1], np.nan) if key[0] == "Q" else np.nan)
        calibration.append(1.0 if key[0] == "C" else np.nan)
    table = np.array(rows)
    circumference = float(optics[-1].s_pos)
    from orbitfb.physics.parameters import SPEED_OF_LIGHT

    frequency = float(ring_data.CavityFrequency)
    empty = tuple("" for _ in names)
    places = PlacesTable(
        name=tuple(names),
        kind=tuple(kinds),
        s=table[:, 0],
        beta=table[:, 1:3].T.copy(),
        phase=table[:, 3:5].T.copy(),
        dispersion=table[:, 5],
        strength=np.array(strength),
        calibration=np.array([calibration, calibration]),
        pv=(empty, empty),
        readback=(empty, empty),
    )
    parameters = RingParameters(
        energy_eV=energy,
        circumference_m=circumference,
        harmonic=max(1, round(frequency * circumference / SPEED_OF_LIGHT)),
        nu_x=float(end[0]),
        nu_y=float(end[1]),
        alpha_c=float(at.get_mcf(lattice)),
    )
    del total
    return Ring(places, parameters), where
