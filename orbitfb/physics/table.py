"""The table of places: a CSV file, parsed column by column and refused where it is wrong."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orbitfb.core.errors import RingError
from orbitfb.core.files.delimited import read_cells
from orbitfb.core.signals import Vector

KINDS = ("BPM", "COR", "QUAD", "SEXT")
"""Kinds of places."""

_OPTICS = ("s_m", "beta_x_m", "beta_y_m", "mu_x_2pi", "mu_y_2pi", "eta_x_m")
_CALIBRATIONS = ("cal_x_rad_per_A", "cal_y_rad_per_A")
_PVS = ("pv_x", "pv_y")
_READBACKS = ("rb_x", "rb_y")
COLUMNS = ("name", "kind", *_OPTICS, "length_m", "strength", *_CALIBRATIONS, *_PVS, *_READBACKS)
"""Columns that the table must have; others are ignored, but `unit`."""
UNIT = "unit"
"""Column that the table may have: the unit of the readings of a BPM at its PVs."""
LENGTH_UNITS = ("m", "mm", "um", "nm")
"""What it may hold."""

_NUMBERS = {
    "BPM": (),
    "COR": _CALIBRATIONS,
    "QUAD": ("length_m", "strength"),
    "SEXT": ("length_m", "strength"),
}
_OF_PLANE = tuple(zip(_PVS, _CALIBRATIONS, _READBACKS, strict=True))
"""Columns of a plane; without a PV the device is not in it."""
_TEXTS = {"BPM": _PVS, "COR": _PVS, "QUAD": (), "SEXT": ()}


@dataclass(frozen=True, slots=True, eq=False)
class PlacesTable:
    """N places in ring order, as columns.

    Args:
        name: N unique names.
        kind: N kinds: `BPM`, `COR`, `QUAD` or `SEXT`.
        s: Position of the centres, shape (N,) [m].
        beta: Rows x and y, shape (2, N) [m].
        phase: Phase advance from s = 0, rows x and y, shape (2, N) [rad].
        dispersion: Horizontal, shape (N,) [m].
        strength: k1L of quadrupoles [1/m], b2L of sextupoles [1/m²], shape (N,); else NaN.
        calibration: Kick per ampere, rows x and y, shape (2, N) [rad/A]; NaN where no corrector, or
            none of that plane.
        pv: BPM readings and corrector setpoints, rows x and y; empty where there is none in that
            plane.
        readback: Corrector readbacks, rows x and y; empty where there is none, or it is the
            setpoint's own PV.
        unit: Of the readings of a BPM at its PVs; empty where it is not said.
    """

    name: tuple[str, ...]
    kind: tuple[str, ...]
    s: Vector
    beta: NDArray[np.float64]
    phase: NDArray[np.float64]
    dispersion: Vector
    strength: Vector
    calibration: NDArray[np.float64]
    pv: tuple[tuple[str, ...], tuple[str, ...]]
    readback: tuple[tuple[str, ...], tuple[str, ...]]
    unit: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class _Row:
    """One line of the file with what a message needs."""

    source: str
    line: int
    cells: dict[str, str]

    def wrong(self, column: str, problem: str, advice: str) -> RingError:
        value = self.cells[column]
        return RingError(
            f"{self.source}, line {self.line}, column {column}: {value!r} {problem}; {advice}"
        )

    def number(self, column: str) -> float:
        try:
            value = float(self.cells[column])
        except ValueError as error:
            raise self.wrong(column, "is not a number", "write a decimal number") from error
        if not math.isfinite(value):
            raise self.wrong(column, "is not finite", "write a finite number")
        return value

    def optional(self, column: str) -> float:
        its = column in _NUMBERS[self.cells["kind"]] and not self.lacks(column)
        return self.number(column) if its else math.nan

    def readback(self, plane: int) -> str:
        """Give the PV of the readback; the setpoint's own tells no more than that there is none."""
        told = self.cells[_READBACKS[plane]]
        return "" if told == self.cells[_PVS[plane]] else told

    def lacks(self, column: str) -> bool:
        """Whether a column is of a plane that the device is not in: it has no PV there."""
        pv = next((pv for pv, *others in _OF_PLANE if column in others), "")
        return bool(pv) and not self.cells[pv]


def parse_places(text: str, source: str, circumference: float) -> PlacesTable:
    """Parse and validate a table of places.

    Args:
        text: The CSV document.
        source: Name of the file, for messages.
        circumference: Upper end of s [m].

    Raises:
        RingError: Naming file, line, column and value of the first fault.
    """
    rows = _rows(text, source)
    for row in rows:
        _check_cells(row, circumference)
    _check_order(rows)
    _check_unique(rows, ("name",))
    _check_unique(rows, _PVS + _READBACKS)
    for kind, what in (("BPM", "readings"), ("COR", "setpoints")):
        if not any(row.cells["kind"] == kind for row in rows):
            raise RingError(
                f"{source}: no place of kind {kind}, so there are no {what}; add at least one row"
            )
    return _columns(rows)


def _rows(text: str, source: str) -> list[_Row]:
    table = read_cells(text, source, RingError).lines
    header, first = (table[0].cells, table[0].number) if table else ((), 1)
    missing = [column for column in COLUMNS if column not in header]
    if missing:
        raise RingError(
            f"{source}, line {first}: column {', '.join(missing)} is missing from the "
            f"header {','.join(header)!r}; add it"
        )
    for line in table:
        if len(line.cells) != len(header):
            raise RingError(
                f"{source}, line {line.number}: {len(line.cells)} cells under {len(header)} "
                f"columns, beginning with {line.cells[0]!r}; give every column a cell, empty or not"
            )
    return [
        _Row(source, line.number, dict(zip(header, line.cells, strict=True))) for line in table[1:]
    ]


def _check_cells(row: _Row, circumference: float) -> None:
    kind = row.cells["kind"]
    if kind not in KINDS:
        raise row.wrong("kind", "is no kind of place", f"use one of {', '.join(KINDS)}")
    for column in (*_OPTICS, *_NUMBERS[kind]):
        if not row.lacks(column):
            row.number(column)
    if not row.cells["name"]:
        raise row.wrong("name", "is empty", "name the place")
    for column in ("beta_x_m", "beta_y_m"):
        if row.number(column) <= 0:
            raise row.wrong(column, "is not above 0", "a beta function is positive")
    if not 0 <= row.number("s_m") <= circumference:
        raise row.wrong("s_m", f"is outside 0 … {circumference} m", "correct s or circumference")
    for column in _CALIBRATIONS if kind == "COR" else ():
        if not row.lacks(column) and row.number(column) == 0:
            raise row.wrong(column, "is a corrector that cannot kick", "give its calibration")
    if kind == "BPM" and row.cells.get(UNIT) not in (None, "", *LENGTH_UNITS):
        raise row.wrong(UNIT, "is no unit of a BPM", f"use one of {', '.join(LENGTH_UNITS)}")
    _check_planes(row)


def _check_planes(row: _Row) -> None:
    """See that a device is in a plane, and has nothing in one that it is not in."""
    kind = row.cells["kind"]
    if not (columns := _TEXTS[kind]):
        return
    if not any(row.cells[column] for column in columns):
        raise row.wrong(
            columns[0],
            f"is no PV, nor is that of {columns[1]}, but a {kind} needs one",
            "give one or both",
        )
    for pv, *others in _OF_PLANE:
        for column in others if not row.cells[pv] else ():
            if row.cells[column]:
                raise row.wrong(
                    column, f"is of a plane without a PV ({pv})", "give the PV, or empty both cells"
                )


def _check_order(rows: Sequence[_Row]) -> None:
    for column in ("s_m", "mu_x_2pi", "mu_y_2pi"):
        for before, row in itertools.pairwise(rows):
            if row.number(column) < before.number(column):
                raise row.wrong(
                    column,
                    f"is less than {before.cells[column]!r} on line {before.line}",
                    "order the rows along the ring",
                )


def _check_unique(rows: Sequence[_Row], columns: tuple[str, ...]) -> None:
    seen: dict[str, tuple[int, str]] = {}
    for row in rows:
        for column in columns:
            value = row.cells[column]
            if column in _READBACKS and not row.readback(_READBACKS.index(column)):
                continue
            if value in seen:
                line, where = seen[value]
                raise row.wrong(
                    column, f"stands already on line {line}, column {where}", "make it unique"
                )
            if value:
                seen[value] = (row.line, column)


def _columns(rows: Sequence[_Row]) -> PlacesTable:
    def numbers(*columns: str) -> Vector:
        return _constant([[row.number(column) for row in rows] for column in columns])

    def optional(*columns: str) -> Vector:
        return _constant([[row.optional(column) for row in rows] for column in columns])

    def texts(column: str) -> tuple[str, ...]:
        return tuple(row.cells[column] for row in rows)

    return PlacesTable(
        name=texts("name"),
        kind=texts("kind"),
        s=numbers("s_m")[0],
        beta=numbers("beta_x_m", "beta_y_m"),
        phase=_constant(2 * np.pi * numbers("mu_x_2pi", "mu_y_2pi")),
        dispersion=numbers("eta_x_m")[0],
        strength=optional("strength")[0],
        calibration=optional(*_CALIBRATIONS),
        pv=(texts("pv_x"), texts("pv_y")),
        readback=(
            tuple(row.readback(0) for row in rows),
            tuple(row.readback(1) for row in rows),
        ),
        unit=tuple(row.cells.get(UNIT) or "" for row in rows),
    )


def _constant(values: ArrayLike) -> Vector:
    """Make an array that nobody can write to: rings are shared."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array
