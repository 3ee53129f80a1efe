"""The ring: its table of places and its global parameters."""

import itertools
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.errors import RingError
from orbitfb.core.files.bounded import LARGEST_TEXT, read_text
from orbitfb.core.signals import Channels, Vector
from orbitfb.physics.parameters import RingParameters, parse_parameters
from orbitfb.physics.table import PlacesTable, parse_places

Plane = Literal["x", "y"]
Planes = Literal["x", "y", "xy"]
Kind = Literal["BPM", "COR", "QUAD", "SEXT"]
Indices = NDArray[np.intp]

_DEVICES: tuple[Kind, ...] = ("BPM", "COR")

_DRIFT = 0.5
"""Largest phase advance of a space without focusing, a waist between two far ends [2π]."""


@dataclass(frozen=True, slots=True, eq=False)
class Ring:
    """A ring as named places, in the order of the places table.

    Args:
        table: The places, one element of every column per place.
        parameters: Tunes, momentum compaction, circumference, harmonic number, energy.
    """

    table: PlacesTable
    parameters: RingParameters

    @classmethod
    def load(cls, places: Path | None = None, parameters: Path | None = None) -> "Ring":
        """Read and validate a ring.

        Args:
            places: Table of places (CSV); the default ring's when None.
            parameters: Global parameters (JSON); the default ring's when None.

        Raises:
            RingError: A file is missing or wrong; the message names file, line, column and value.
        """
        if places is None and parameters is None:
            return _default_ring()
        return _read(places, parameters)

    def check(self, places_file: str, ring_file: str) -> None:
        """Refuse counts and tunes that are not those of the table.

        Args:
            places_file: Name of the table, for messages.
            ring_file: Name of the file of parameters, for messages.

        Raises:
            RingError: They do not fit.
        """
        self._check_counts(places_file, ring_file)
        self._check_tunes(places_file, ring_file)

    def _check_counts(self, places_file: str, ring_file: str) -> None:
        for kind, wanted in self.parameters.counts.items():
            found = self.table.kind.count(kind)
            if found != wanted:
                raise RingError(
                    f"{places_file}: {found} places of kind {kind}, but {ring_file} says that the "
                    f"ring has {wanted}; restore the missing rows, or "
                    "give the ring its own file of parameters with its `counts` (ring.parameters)"
                )

    def _check_tunes(self, places_file: str, ring_file: str) -> None:
        """Refuse a tune that the phases of the table do not lead up to.

        Between the last place and the first one, past s = 0, the phase grows by no more than half
        a turn if nothing focuses there; a table that leaves quadrupoles out may have more, but not
        much more than between other neighbours.
        """
        planes: tuple[Plane, ...] = ("x", "y")
        for plane in planes:
            tune = self.tune(plane)
            phase = self.table.phase[plane_row(plane)] / (2 * np.pi)
            seam = tune - phase[-1] + phase[0]
            most = max(_DRIFT, 2.0 * float(np.diff(phase).max(initial=0.0)))
            if phase[-1] <= tune and seam <= most:
                continue
            raise RingError(
                f"{ring_file}: nu_{plane} = {tune} does not fit {places_file}: mu_{plane}_2pi ends "
                f"at {phase[-1]:.4g} there, so the tune lies between {phase[-1]:.4g} and "
                f"{phase[-1] - phase[0] + most:.4g}; correct the one that is mistyped"
            )

    def places(self, kind: Kind, plane: Plane | None = None) -> Indices:
        """Indices of the places of one kind, in ring order, shape (k,).

        Args:
            kind: Of the places.
            plane: BPMs and correctors that are in this plane; None: in either.
        """
        found = [i for i, its_kind in enumerate(self.table.kind) if its_kind == kind]
        if plane is not None and kind in ("BPM", "COR"):
            found = [i for i in found if self.table.pv[plane_row(plane)][i]]
        return np.array(found, dtype=np.intp)

    def names(self, kind: Kind, plane: Plane | None = None) -> tuple[str, ...]:
        """Names of the places of one kind, in ring order; see `places`."""
        return tuple(self.table.name[int(i)] for i in self.places(kind, plane))

    def strength(self, kind: Literal["QUAD", "SEXT"]) -> Vector:
        """Integrated strengths k1L [1/m] or b2L [1/m²] of one kind, shape (k,)."""
        return self.table.strength[self.places(kind)]

    def calibration(self, plane: Plane) -> Vector:
        """Kick per ampere of every corrector of a plane, (180,) for the default ring [rad/A]."""
        return self.table.calibration[plane_row(plane), self.places("COR", plane)]

    def tune(self, plane: Plane) -> float:
        """Betatron tune with its integer part."""
        return self.parameters.nu_x if plane == "x" else self.parameters.nu_y

    @property
    def rf_frequency(self) -> float:
        """Nominal RF frequency of the ultra-relativistic beam [Hz]."""
        return self.parameters.rf_frequency

    def devices_of_pvs(self, kind: Kind) -> dict[str, tuple[str, Plane]]:
        """Device and plane behind the PV of every reading, setpoint and readback of one kind."""
        table = self.table
        return {
            pvs[row][int(index)]: (table.name[int(index)], plane)
            for pvs in (table.readback, table.pv)
            for row, plane in enumerate(split("xy"))
            for index in self.places(kind)
            if pvs[row][int(index)]
        }

    def channels(self, planes: Planes) -> Channels:
        """Names behind the orbit and the setpoints, x first and then y.

        Args:
            planes: `x`, `y` or `xy`.

        Raises:
            RingError: No BPM or no corrector is in one of them.
        """
        each, table = split(planes), self.table
        for kind, plane in itertools.product(_DEVICES, each):
            if not len(self.places(kind, plane)):
                raise RingError(
                    f"no place of kind {kind} is in plane {plane}: fill in its pv_{plane}, or set "
                    "ring.planes to the other plane"
                )

        def of(kind: Kind) -> list[tuple[int, int]]:
            return [(plane_row(plane), int(i)) for plane in each for i in self.places(kind, plane)]

        bpms, correctors = of("BPM"), of("COR")
        units = tuple(table.unit[i] for _, i in bpms) if table.unit else ()
        return Channels(
            planes=planes,
            bpms=tuple(table.name[i] for _, i in bpms),
            correctors=tuple(table.name[i] for _, i in correctors),
            orbit_pvs=tuple(table.pv[row][i] for row, i in bpms),
            setpoint_pvs=tuple(table.pv[row][i] for row, i in correctors),
            readback_pvs=tuple(table.readback[row][i] for row, i in correctors),
            bpm_counts=self._counts("BPM", each),
            corrector_counts=self._counts("COR", each),
            bpm_units=units if any(units) else (),
        )

    def _counts(self, kind: Kind, each: tuple[Plane, ...]) -> tuple[int, ...]:
        """Count the devices of each plane; empty where there are as many in each."""
        counts = tuple(len(self.places(kind, plane)) for plane in each)
        return counts if len(set(counts)) > 1 else ()


def split(planes: Planes) -> tuple[Plane, ...]:
    """Split `x`, `y` or `xy` into single planes, x first."""
    return ("x", "y") if planes == "xy" else (planes,)


def plane_row(plane: Plane) -> int:
    """Row of a plane in the (2, N) columns of the table."""
    return 0 if plane == "x" else 1


@cache
def _default_ring() -> Ring:
    """Read the files of this package once: they do not change, and nobody can write to a ring."""
    return _read(None, None)


def _read(places: Path | None, parameters: Path | None) -> Ring:
    ring_file, ring_text = _text(parameters, "ring.json")
    places_file, places_text = _text(places, "places.csv")
    ring_parameters = parse_parameters(ring_text, ring_file)
    ring = Ring(
        parse_places(places_text, places_file, ring_parameters.circumference), ring_parameters
    )
    ring.check(places_file, ring_file)
    return ring


def _text(path: Path | None, default: str) -> tuple[str, str]:
    if path is None:
        packaged = resources.files("orbitfb") / "data" / default
        return f"orbitfb/data/{default}", packaged.read_text(encoding="utf-8")
    advice = "correct the path in the configuration"
    return str(path), read_text(path, LARGEST_TEXT, RingError, advice)
