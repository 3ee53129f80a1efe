"""What a case stands in: ring, loop, excitation, noise, ground and a background of small errors."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from benchmarks.blind.generator.rings import Array, Index, Lattice, cell_of, write_second_ring
from orbitfb.physics.optics import green
from orbitfb.physics.places import Plane, Planes, Ring, split

Dither = Literal["passive", "white", "shaped"]


@dataclass(frozen=True)
class GroundLaw:
    """How the ground of a plane moves: m' = keep m + s', s' = on s + chance.

    Args:
        keep: Share of where it is that it keeps from row to row [1]; 1: it walks.
        on: Share of its last step that it goes on by [1].
    """

    keep: float = 1.0
    on: float = 0.0


@dataclass(eq=False)
class Conditions:
    """Everything about a case but its effect.

    Args:
        lattice: Ring with the gradient errors that nobody knows.
        ring_id: `first` or `second`.
        planes: `x`, `y` or `xy`.
        ticks: Transitions in the record.
        warm: Ticks before its first row.
        period: [s].
        delay: Of the write after the read, in periods.
        gain: Of the loop.
        regularisation: λ over the largest singular value.
        noise: Of the readings, per column (n,) [m].
        stated_noise: What the record says of it [m]; NaN when it does not.
        bpm_gains: Unknown gains less 1, (n,).
        corrector_gains: The same of correctors, (m,).
        dither_kind: How the setpoints are excited.
        dither: Excursions, (warm + T + 1, m) [A].
        reference: (warm + T + 1, n) [m].
        quad_kicks: Of misplaced quadrupoles, by plane, (warm + T + 1, q) [rad].
        ground: Name of the law by which they move.
        ground_laws: That law, by plane.
        current: Of the beam, (warm + T + 1,) [A].
        gap: Of an insertion device, (warm + T + 1,) [m].
    """

    lattice: Lattice
    ring_id: str
    planes: Planes
    ticks: int
    warm: int
    period: float
    delay: float
    gain: float
    regularisation: float
    noise: Array
    stated_noise: float
    bpm_gains: Array
    corrector_gains: Array
    dither_kind: Dither
    dither: Array
    reference: Array
    quad_kicks: dict[Plane, Array]
    ground: str
    ground_laws: dict[Plane, GroundLaw]
    ground_step: float
    current: Array
    gap: Array

    @property
    def rows(self) -> int:
        return self.warm + self.ticks + 1

    @cached_property
    def bpm_names(self) -> list[str]:
        return [*self.lattice.ring.names("BPM")] * len(split(self.planes))

    @cached_property
    def corr_names(self) -> list[str]:
        return [*self.lattice.ring.names("COR")] * len(split(self.planes))

    @cached_property
    def bpms(self) -> Index:
        return self.lattice.ring.places("BPM")

    @cached_property
    def correctors(self) -> Index:
        return self.lattice.ring.places("COR")

    @property
    def all_planes(self) -> tuple[Plane, ...]:
        return split(self.planes)

    def bpm_columns(self, plane: Plane) -> slice:
        start = self.all_planes.index(plane) * len(self.bpms)
        return slice(start, start + len(self.bpms))

    def corrector_columns(self, plane: Plane) -> slice:
        start = self.all_planes.index(plane) * len(self.correctors)
        return slice(start, start + len(self.correctors))

    def groups(self, names: list[str], plane: Plane | None = None) -> dict[str, Index]:
        """Columns by cell, of one plane."""
        found: dict[str, list[int]] = {}
        width = len(names) // len(self.all_planes)
        first = 0 if plane is None else self.all_planes.index(plane) * width
        for column in range(first, first + width):
            found.setdefault(cell_of(names[column]), []).append(column)
        return {cell: np.array(columns) for cell, columns in found.items()}

    @cached_property
    def model(self) -> Array:
        """Response that everybody believes, (n, m) [m/A]."""
        ring = self.lattice.ring
        blocks = [
            green(ring, self.bpms, self.correctors, plane) * ring.calibration(plane)
            for plane in self.all_planes
        ]
        return _diagonal(blocks)

    @cached_property
    def controller(self) -> Array:
        """Tikhonov inverse of the model, (m, n) [A/m]."""
        return tikhonov(self.model, self.regularisation)

    def true_response(self, extra: Array | None = None) -> Array:
        """Response of the ring (gains of correctors apart), (n, m) [m/A]."""
        ring = self.lattice.ring
        blocks = [
            self.lattice.response(self.bpms, self.correctors, plane, extra)
            * ring.calibration(plane)
            for plane in self.all_planes
        ]
        return _diagonal(blocks)

    def moved(
        self,
        observers: Index,
        plane: Plane,
        extra: Array | None = None,
        rows: slice = slice(None),
    ) -> Array:
        """Orbit of the misplaced quadrupoles at some places, (rows, k) [m]."""
        orbit = self.lattice.response(observers, self.lattice.quads, plane, extra)
        return self.quad_kicks[plane][rows] @ orbit.T

    def moved_at_bpms(self, extra: Array | None = None, rows: slice = slice(None)) -> Array:
        return np.hstack([self.moved(self.bpms, p, extra, rows) for p in self.all_planes])

    def kick_orbit(self, place: Index, plane: Plane) -> Array:
        """Orbit per kick at places of the ring, rows of the other plane zero, (n, k) [m/rad]."""
        orbit = np.zeros((len(self.bpm_names), len(place)))
        orbit[self.bpm_columns(plane)] = self.lattice.response(self.bpms, place, plane)
        return orbit

    def orbit_at(self, place: Index, plane: Plane) -> Array:
        """Orbit at places per ampere of every corrector, (k, m) [m/A]."""
        orbit = np.zeros((len(place), len(self.corr_names)))
        orbit[:, self.corrector_columns(plane)] = self.lattice.response(
            place, self.correctors, plane
        ) * self.lattice.ring.calibration(plane)
        return orbit

    @cached_property
    def dispersion(self) -> Array:
        """At the BPM columns, (n,) [m]."""
        eta = np.zeros(len(self.bpm_names))
        if "x" in self.all_planes:
            eta[self.bpm_columns("x")] = self.lattice.ring.table.dispersion[self.bpms]
        return eta


def _diagonal(blocks: list[Array]) -> Array:
    rows, columns = sum(b.shape[0] for b in blocks), sum(b.shape[1] for b in blocks)
    whole, r, c = np.zeros((rows, columns)), 0, 0
    for block in blocks:
        whole[r : r + block.shape[0], c : c + block.shape[1]] = block
        r, c = r + block.shape[0], c + block.shape[1]
    return whole


def tikhonov(model: Array, regularisation: float) -> Array:
    """Invert with σ / (σ² + λ²), λ relative to the largest σ."""
    left, size, right = np.linalg.svd(model, full_matrices=False)
    floor = regularisation * size[0]
    return (right.T * (size / (size**2 + floor**2))) @ left.T


def second_ring(folder: Path, seed: int) -> Ring:
    """A synthetic ring whose tunes are clear of resonances."""
    for attempt in range(100):
        rng = np.random.default_rng([seed, attempt])
        places, figures = write_second_ring(folder, rng)
        ring = Ring.load(places, figures)
        clear = [abs(((2 * ring.tune(p)) % 1) - 0.5) for p in ("x", "y")]
        if max(clear) < 0.35:  # at least 0.07 from integer and half-integer
            return ring
    raise RuntimeError("no ring with tunes clear of resonances in 100 draws")
