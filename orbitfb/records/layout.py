"""Which devices a record or a plant has, and what the optics make of a kick at any place."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.errors import RingError
from orbitfb.core.signals import Vector
from orbitfb.physics.optics import Matrix, green
from orbitfb.physics.places import Indices, Kind, Plane, Ring

ChannelPlane = Literal["x", "y"]


@dataclass(frozen=True, slots=True)
class Devices:
    """The devices behind the columns of an orbit or of a set of setpoints.

    Args:
        names: k names; a device that acts in both planes has one column in each.
        planes: k planes.
        cells: k cells (`C30`, …) or crates, whatever groups them; empty text where not known.
        channels: What a record calls the columns if not by these names (PVs); empty otherwise.
    """

    names: tuple[str, ...]
    planes: tuple[ChannelPlane, ...]
    cells: tuple[str, ...]
    channels: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.names)

    def in_plane(self, plane: ChannelPlane) -> Indices:
        """Columns of one plane, shape (k',)."""
        return np.array([i for i, its in enumerate(self.planes) if its == plane], dtype=np.intp)

    def groups(self) -> dict[str, Indices]:
        """Columns of every cell, both planes together, in the order of the cells."""
        members: dict[str, list[int]] = {}
        for column, cell in enumerate(self.cells):
            if cell:
                members.setdefault(cell, []).append(column)
        return {cell: np.array(columns, dtype=np.intp) for cell, columns in members.items()}

    def only(self, columns: Indices) -> "Devices":
        """Some of the columns."""
        kept = [int(i) for i in columns]
        return Devices(
            tuple(self.names[i] for i in kept),
            tuple(self.planes[i] for i in kept),
            tuple(self.cells[i] for i in kept),
            tuple(self.channels[i] for i in kept) if self.channels else (),
        )

    def label(self, column: int) -> str:
        """Name of a column for people: the device's, with its plane."""
        return f"{self.names[column]} ({self.planes[column]})"


@dataclass(frozen=True, slots=True, eq=False)
class HealthyErrors:
    """Small errors that any ring has.

    Args:
        gains: Of correctors, less 1, shape (m,).
        kicks: Of every quadrupole per orbit in it, plane by plane, shape (q,) [1/m].
    """

    gains: Vector
    kicks: Mapping[ChannelPlane, Vector]


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """The devices, and the model that is to be questioned.

    Args:
        bpms: Behind the n columns of an orbit.
        correctors: Behind the m columns of a set of setpoints.
        response: Nominal response, shape (n, m) [m/A].
        period: From one orbit to the next [s].
        ring: The ring that the names belong to; None when they are of no known ring. Effects of
            the optics then cannot be tested, and sources are looked for at the correctors only.
        restless: Scatter of the healthy gradients over what is usual in a ring.
        healthy: Small errors that the record has shown; what they do beyond their own sum has been
            taken out of its readings. None: not known yet.
    """

    bpms: Devices
    correctors: Devices
    response: Matrix
    period: float
    ring: Ring | None
    restless: float = 1.0
    healthy: HealthyErrors | None = None

    def orbit_per_kick(self, sources: Indices | Kind, plane: Plane) -> Matrix:
        """Orbit at the BPMs per kick in one plane at places of the ring, shape (n, k) [m/rad].

        Rows of BPMs of the other plane are zero (upright magnets do not couple the planes). That of
        all places of a kind is computed once, and cannot be written to.
        """
        if isinstance(sources, str):
            return _of_kind(self, sources, plane)
        return _of_places(self, sources, plane)

    def orbit_at(self, places: Indices | Kind, plane: Plane) -> Matrix:
        """Orbit at places of the ring per ampere of every corrector, shape (k, m) [m/A].

        That at all places of a kind is computed once, and cannot be written to.
        """
        if isinstance(places, str):
            return _at_kind(self, places, plane)
        return _at_places(self, places, plane)

    def dispersion(self) -> Vector:
        """Dispersion at the BPMs, zero in y, shape (n,) [m]."""
        ring = self.known_ring
        eta = np.zeros(len(self.bpms))
        columns = self.bpms.in_plane("x")
        places = _indices(ring, [self.bpms.names[int(i)] for i in columns])
        eta[columns] = ring.table.dispersion[places]
        return eta

    @property
    def known_ring(self) -> Ring:
        """The ring.

        Raises:
            RingError: The devices are of no known ring.
        """
        if self.ring is None:
            raise RingError(
                "the names of the devices are of no known ring; give its table of places "
                "(ring.places), or leave out the effects of optics and sources"
            )
        return self.ring

    @property
    def planes(self) -> tuple[ChannelPlane, ...]:
        """Planes that have BPMs, x first."""
        return tuple(plane for plane in ("x", "y") if plane in self.bpms.planes)


def _of_places(layout: Layout, sources: Indices | Kind, plane: Plane) -> Matrix:
    """Orbit at the BPMs per kick, zero for those of the other plane, shape (n, k) [m/rad]."""
    ring = layout.known_ring
    columns = layout.bpms.in_plane(plane)
    places = _indices(ring, [layout.bpms.names[int(i)] for i in columns])
    where = ring.places(sources) if isinstance(sources, str) else sources
    orbit = np.zeros((len(layout.bpms), len(where)))
    orbit[columns] = green(ring, places, where, plane)
    return orbit


def _at_places(layout: Layout, places: Indices | Kind, plane: Plane) -> Matrix:
    """Orbit at places of the ring per ampere of every corrector, shape (k, m) [m/A]."""
    ring = layout.known_ring
    columns = layout.correctors.in_plane(plane)
    sources = _indices(ring, [layout.correctors.names[int(i)] for i in columns])
    table_row = 0 if plane == "x" else 1
    per_ampere = ring.table.calibration[table_row, sources]
    where = ring.places(places) if isinstance(places, str) else places
    orbit = np.zeros((len(where), len(layout.correctors)))
    orbit[:, columns] = green(ring, where, sources, plane) * per_ampere
    return orbit


@lru_cache(maxsize=32)
def _of_kind(layout: Layout, kind: Kind, plane: Plane) -> Matrix:
    orbit = _of_places(layout, kind, plane)
    orbit.setflags(write=False)
    return orbit


@lru_cache(maxsize=32)
def _at_kind(layout: Layout, kind: Kind, plane: Plane) -> Matrix:
    orbit = _at_places(layout, kind, plane)
    orbit.setflags(write=False)
    return orbit


def _indices(ring: Ring, names: Sequence[str]) -> NDArray[np.intp]:
    place = {name: index for index, name in enumerate(ring.table.name)}
    return np.array([place[name] for name in names], dtype=np.intp)
