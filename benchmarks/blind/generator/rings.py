"""The rings of the blind cases: the packaged one, and a second one made from thin lenses."""

import json
from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orbitfb.physics.optics import green
from orbitfb.physics.places import Plane, Ring

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(eq=False)
class Lattice:
    """A ring whose quadrupoles may be wrong; closed orbits by the full Green's function.

    Args:
        ring: Table of places.
        errors: Δk1L of every quadrupole, shape (q,) [1/m].
    """

    ring: Ring
    errors: Array
    _nominal: dict[tuple[str, str, str], Array] = field(default_factory=dict)

    @cached_property
    def quads(self) -> Index:
        return self.ring.places("QUAD")

    @cached_property
    def place(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.ring.table.name)}

    def indices(self, names: list[str]) -> Index:
        return np.array([self.place[name] for name in names], dtype=np.intp)

    def response(
        self, observers: Index, sources: Index, plane: Plane, extra: Array | None = None
    ) -> Array:
        """Orbit per kick [m/rad] with the errors (and more of them): G + G K (1 − G K)⁻¹ G."""
        errors = self.errors if extra is None else self.errors + extra
        wrong = np.flatnonzero(errors)
        direct = green(self.ring, observers, sources, plane)
        if not wrong.size:
            return direct
        at = self.quads[wrong]
        kick = (-errors if plane == "x" else errors)[wrong]
        loop = np.eye(len(at)) - green(self.ring, at, at, plane) * kick
        inside = np.linalg.solve(loop, green(self.ring, at, sources, plane))
        return direct + (green(self.ring, observers, at, plane) * kick) @ inside


def beating_errors(ring: Ring, beat: float, rng: np.random.Generator) -> Array:
    """Draw Δk1L [1/m] that leave the tunes and beat β_x by a given rms ratio (first order)."""
    quads, bpms = ring.places("QUAD"), ring.places("BPM")
    strength, beta, phase = ring.strength("QUAD"), ring.table.beta, ring.table.phase
    relative = rng.standard_normal(len(quads))
    tunes = (beta[:, quads] * strength).T
    relative -= tunes @ np.linalg.lstsq(tunes, relative, rcond=None)[0]
    errors = relative * strength
    far = np.abs(phase[0, bpms][:, None] - phase[0, quads])
    turn = 2 * np.pi * ring.tune("x")
    wave = np.cos(2 * far - turn) @ (beta[0, quads] * errors) / (2 * np.sin(turn))
    return errors * beat / np.sqrt(np.mean(wave**2))


def _lens(strength: float) -> Array:
    """Thin lens in (x, x', δ) horizontally; negative strengths for the other plane."""
    matrix = np.eye(3)
    matrix[1, 0] = -strength
    return matrix


def _drift(length: float, angle: float = 0.0) -> Array:
    """Drift with a thin bend of small angle in its middle (no edge focusing)."""
    matrix = np.eye(3)
    matrix[0, 1] = length
    matrix[0, 2] = angle * length / 2
    matrix[1, 2] = angle
    return matrix


def write_second_ring(folder: Path, rng: np.random.Generator) -> tuple[Path, Path]:
    """Make a FODO ring of other size and tunes, with BPMs and correctors missing; write its table.

    Every cell: QF, sextupole, BPM, corrector, bend, QD, BPM, sextupole, corrector, bend.

    Returns:
        Places (CSV) and parameters (JSON).
    """
    cells, focal = int(rng.integers(22, 31)), float(rng.uniform(0.27, 0.36))
    gap, angle = 0.6, 2 * np.pi / (2 * cells)
    # kind, name, length to the next, thin strength, bend on the way
    line = [
        ("QUAD", "QF", 0.5, focal),
        ("BPM", "BA", 0.3, 0.0),
        ("SEXT", "SF", 0.4, 0.0),
        ("COR", "HA", 0.3 + gap, 0.0),
        ("MARK", "M1", 2.2, 0.0),
        ("QUAD", "QD", 0.5, -focal * float(rng.uniform(0.84, 0.97))),
        ("BPM", "BB", 0.3, 0.0),
        ("SEXT", "SD", 0.4, 0.0),
        ("COR", "HB", 0.3 + gap, 0.0),
        ("MARK", "M2", 2.2, 0.0),
    ]

    def walk(plane: int) -> list[tuple[Array, Array]]:
        sign = 1 if plane == 0 else -1
        steps = []
        for _kind, name, length, strength in line:
            bend = angle if plane == 0 and name in ("M1", "M2") else 0.0
            steps.append((_lens(sign * strength), _drift(length, bend)))
        return steps

    optics = []
    for plane in (0, 1):
        steps = walk(plane)
        turn = np.eye(3)
        for lens, drift in steps:
            turn = drift @ lens @ turn
        cosine = np.trace(turn[:2, :2]) / 2
        sine = np.sign(turn[0, 1]) * np.sqrt(1 - cosine**2)
        beta, alpha = turn[0, 1] / sine, (turn[0, 0] - turn[1, 1]) / (2 * sine)
        eta = np.linalg.solve(np.eye(2) - turn[:2, :2], turn[:2, 2])
        state, phase, rows = (beta, alpha, np.array([*eta, 1.0])), 0.0, []
        for lens, drift in steps:
            rows.append((state[0], phase, state[2][0]))
            for matrix in (lens, drift):
                c, s, c1, s1 = matrix[0, 0], matrix[0, 1], matrix[1, 0], matrix[1, 1]
                b, a = state[0], state[1]
                g = (1 + a * a) / b
                phase += np.arctan2(s, c * b - s * a)
                new_b = c * c * b - 2 * c * s * a + s * s * g
                new_a = -c * c1 * b + (c * s1 + s * c1) * a - s * s1 * g
                state = (new_b, new_a, matrix @ state[2])
        optics.append((rows, phase))
    per_cell = sum(length for _, _, length, _ in line)
    circumference = per_cell * cells
    bends = [row for row, item in enumerate(line) if item[0] == "MARK"]
    alpha_c = sum(optics[0][0][row][2] * angle for row in bends) * cells / circumference
    header = (
        "name,kind,s_m,beta_x_m,beta_y_m,mu_x_2pi,mu_y_2pi,eta_x_m,length_m,strength,"
        "cal_x_rad_per_A,cal_y_rad_per_A,pv_x,pv_y,rb_x,rb_y"
    )
    missing = {f"BB_D{int(c):02d}" for c in rng.choice(cells, size=cells // 6, replace=False)}
    missing |= {f"HB_D{int(c):02d}" for c in rng.choice(cells, size=cells // 3, replace=False)}
    text, counts = [header], Counter[str]()
    for cell in range(cells):
        at = 0.2 + cell * per_cell
        for row, (kind, short, length, strength) in enumerate(line):
            name = f"{short}_D{cell:02d}"
            if kind != "MARK" and name not in missing:
                (bx, mx, eta), (by, my, _) = optics[0][0][row], optics[1][0][row]
                mx, my = mx + cell * optics[0][1], my + cell * optics[1][1]
                value = {"QUAD": f"{strength:.9g}", "SEXT": "6.0" if short == "SF" else "-9.0"}
                calibrations = f"{4e-5 * (1 + 0.2 * (short == 'HB')):.6g}" if kind == "COR" else ""
                pvs = [f"B:{name}:{p}" if kind in ("BPM", "COR") else "" for p in "XY"]
                backs = [f"B:{name}:{p}:RB" if kind == "COR" else "" for p in "XY"]
                cells_of = [name, kind, f"{at:.5f}", f"{bx:.9g}", f"{by:.9g}"]
                cells_of += [f"{mx / (2 * np.pi):.9f}", f"{my / (2 * np.pi):.9f}", f"{eta:.9g}"]
                cells_of += ["0.2", value.get(kind, ""), calibrations, calibrations, *pvs, *backs]
                text.append(",".join(cells_of))
                counts[kind] += 1
            at += length
    parameters = {
        "energy_eV": 1.7e9,
        "circumference_m": circumference,
        "harmonic": 400,
        "nu_x": cells * optics[0][1] / (2 * np.pi),
        "nu_y": cells * optics[1][1] / (2 * np.pi),
        "alpha_c": alpha_c,
        "counts": dict(counts),
    }
    places, figures = folder / "second-ring.csv", folder / "second-ring.json"
    places.write_text("\n".join(text) + "\n", encoding="utf-8")
    figures.write_text(json.dumps(parameters, indent=1), encoding="utf-8")
    return places, figures


def cell_of(name: str) -> str:
    """Cell that a name tells: `CH1A_C30` → `C30`."""
    return name.rsplit("_", 1)[-1]
