"""Public files of measured responses: LOCO files of the Matlab Middle Layer, and PETRA III.

Needs accelerator-toolbox (of the `dev` extra) for the lattices.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from benchmarks.measured_lattice import Key, ring_of
from orbitfb.loco.measured import PLANES, Measured, Pair
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Plane, Ring

PETRA_LEFT_OUT = (24, 104, 108, 111, 123, 138, 144, 153, 161, 162, 243)
"""BPMs that the laboratory's own fit of PETRA III left out, by their number from 0."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredRing:
    """A measured response with the lattice that it was measured on.

    Args:
        ring: Of its lattice, with all devices.
        measured: Its matrix [m/rad].
        laboratory: Gains of BPMs, calibrations of correctors and ΔK/K of quadrupoles of the
            laboratory's own fit, by `gain:x`, `calibration:y`, `gradient`, …; what it lacks is
            not in it.
        noise: Of a reading, per plane [m].
        kick: Of every corrector, per plane [rad].
    """

    ring: Ring
    measured: Measured
    laboratory: dict[str, np.ndarray]
    noise: dict[Plane, np.ndarray]
    kick: dict[Plane, np.ndarray]


def read(path: Path, left_out: tuple[int, ...] = ()) -> MeasuredRing:
    """Read a LOCO file, or the folder of PETRA III.

    Args:
        path: A `.mat` file of LOCO, or a folder with `measurement_matlab.npy` in it.
        left_out: BPMs of PETRA III that are left out.
    """
    return _petra(path, left_out) if path.is_dir() else _loco(path)


def _loco(path: Path) -> MeasuredRing:
    data = loadmat(path, struct_as_record=False, squeeze_me=True)
    bpm, corrector = np.ravel(data["BPMData"]), np.ravel(data["CMData"])
    loco, ring_data = data["LocoMeasData"], data["RINGData"]
    first, last = bpm[0], bpm[-1]
    index = np.ravel(first.BPMIndex)
    bpms: dict[Plane, np.ndarray] = {
        "x": index[np.ravel(first.HBPMIndex) - 1] - 1,
        "y": index[np.ravel(first.VBPMIndex) - 1] - 1,
    }
    correctors: dict[Plane, np.ndarray] = {
        "x": np.ravel(corrector[0].HCMIndex) - 1,
        "y": np.ravel(corrector[0].VCMIndex) - 1,
    }
    cells = np.ravel(ring_data.Lattice)
    ring, where = ring_of(
        [_element(cell) for cell in cells],
        {*bpms["x"], *bpms["y"]},
        {*correctors["x"], *correctors["y"]},
        float(getattr(cells[-1], "Energy", 3e9)),
        float(ring_data.CavityFrequency),
    )
    kick: dict[Plane, np.ndarray] = {
        "x": 1e-3 * np.ravel(corrector[0].HCMKicks).astype(float),
        "y": 1e-3 * np.ravel(corrector[0].VCMKicks).astype(float),
    }
    std, rows = 1e-3 * np.ravel(loco.BPMSTD).astype(float), len(bpms["x"])
    noise: dict[Plane, np.ndarray] = {"x": std[:rows], "y": std[rows:]}
    laboratory = {
        "gain:x": np.ravel(last.HBPMGain).astype(float),
        "gain:y": np.ravel(last.VBPMGain).astype(float),
        "calibration:x": np.ravel(corrector[-1].HCMKicks) * 1e-3 / kick["x"],
        "calibration:y": np.ravel(corrector[-1].VCMKicks) * 1e-3 / kick["y"],
    }
    orbits = 1e-3 * np.asarray(loco.M, dtype=float)
    measured = _measured(orbits, bpms, correctors, where, kick, noise)
    return MeasuredRing(ring, measured, laboratory, noise, kick)


def _petra(folder: Path, left_out: tuple[int, ...]) -> MeasuredRing:
    import at

    lattice = at.load_lattice(str(folder / "p3_low_beta.mat"))
    names: list[set[str]] = [
        set((folder / name).read_text(encoding="utf-8").split())
        for name in ("HCM_names.txt", "VCM_names.txt")
    ]
    # the rows and columns of its matrices are in the order of the lattice
    correctors: dict[Plane, np.ndarray] = {
        plane: np.array([i for i, e in enumerate(lattice) if getattr(e, "CommonName", "") in its])
        for plane, its in zip(PLANES, names, strict=True)
    }
    monitors = np.array([i for i, e in enumerate(lattice) if isinstance(e, at.Monitor)])
    kept = np.setdiff1d(np.arange(len(monitors)), left_out)
    bpms: dict[Plane, np.ndarray] = dict.fromkeys(PLANES, monitors[kept])
    cavity = next(e for e in lattice if isinstance(e, at.RFCavity))
    ring, where = ring_of(
        lattice, monitors, [*correctors["x"], *correctors["y"]], lattice.energy, cavity.Frequency
    )
    steps = np.load(folder / "CMstep.npz", allow_pickle=False)
    kick: dict[Plane, np.ndarray] = {"x": steps["hor"].ravel(), "y": steps["ver"].ravel()}
    noise: dict[Plane, np.ndarray] = {
        plane: np.load(folder / f"Noise_BPM{plane}.npy", allow_pickle=False)[kept]
        for plane in PLANES
    }
    orbits = np.load(folder / "measurement_matlab.npy", allow_pickle=False)
    orbits = orbits.reshape(2, len(monitors), -1)[:, kept].reshape(2 * len(kept), -1)
    measured = _measured(orbits, bpms, correctors, where, kick, noise)
    laboratory = _fit_of_petra(folder, lattice, ring, kick, kept)
    return MeasuredRing(ring, measured, laboratory, noise, kick)


def _fit_of_petra(
    folder: Path, lattice: Any, ring: Ring, kick: dict[Plane, np.ndarray], kept: np.ndarray
) -> dict[str, np.ndarray]:
    """The laboratory's fit of 8 steps, of the BPMs that it kept."""
    fitted = np.load(folder / "matlab_fit_8iter.npy", allow_pickle=False)
    quadrupoles = np.load(folder / "quad_ind.npy", allow_pickle=False)
    there = 246 - len(PETRA_LEFT_OUT)
    counts = (there, there, len(kick["x"]), len(kick["y"]), len(kick["x"]))
    parts = np.split(fitted, np.cumsum(counts))
    its = np.setdiff1d(np.arange(246), PETRA_LEFT_OUT)
    gains = np.full((2, 246), np.nan)
    gains[:, its] = parts[0], parts[1]
    change = {
        f"Q{i}": k / lattice[int(i)].PolynomB[1] - 1
        for i, k in zip(quadrupoles, parts[5], strict=True)
    }
    return {
        "gain:x": gains[0, kept],
        "gain:y": gains[1, kept],
        "calibration:x": parts[2] / kick["x"],
        "calibration:y": parts[3] / kick["y"],
        "gradient": np.array([change.get(name, np.nan) for name in ring.names("QUAD")]),
    }


def _measured(
    orbits: Matrix,
    bpms: Mapping[Plane, np.ndarray],
    correctors: Mapping[Plane, np.ndarray],
    where: Mapping[Key, int],
    kick: Mapping[Plane, np.ndarray],
    noise: Mapping[Plane, np.ndarray],
) -> Measured:
    """Cut the stacked changes of orbits [m] into blocks; an exact zero was not measured."""
    rows = dict(zip(PLANES, np.split(orbits, [len(bpms["x"])]), strict=True))
    response: dict[Pair, Matrix] = {}
    sigma: dict[Pair, Matrix] = {}
    for read_plane in PLANES:
        blocks = np.split(rows[read_plane], [len(kick["x"])], axis=1)
        for driven, block in zip(PLANES, blocks, strict=True):
            response[read_plane, driven] = np.where(block == 0.0, np.nan, block) / kick[driven]
            change = np.sqrt(2.0) * noise[read_plane][:, None]
            sigma[read_plane, driven] = change / np.abs(kick[driven])
    return Measured(
        {p: np.array([where["B", int(i)] for i in bpms[p]]) for p in PLANES},
        {p: np.array([where["C", int(j)] for j in correctors[p]]) for p in PLANES},
        response,
        sigma,
    )


def _element(cell: Any) -> Any:
    """Read an element of a Matlab lattice as its linear optics."""
    import at

    def get(key: str, other: Any = 0.0) -> Any:
        return getattr(cell, key, other)

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
    if length and second.size > 2 and second[2]:
        return at.Sextupole(name, length, float(second[2]))
    return at.Drift(name, length) if length else at.Marker(name)
