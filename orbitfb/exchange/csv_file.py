"""Read a table of numbers from CSV: names above the columns, names before the rows, or neither."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from orbitfb.core.errors import ExchangeError
from orbitfb.core.signals import Vector
from orbitfb.exchange.found import LARGEST_ARRAY, Found, absent, check_size, check_text

COLUMNS, ROWS, VALUES = "columns", "rows", "values"
"""The paths within a CSV file: names above, names before, the numbers."""

_DELIMITERS = ("\t", ";", ",")
_LONGEST_LINE = 2**22


class CsvSource:
    """A CSV file, delimited by tabs, semicolons or commas; lines that begin with # are skipped.

    Args:
        path: The file.

    Raises:
        ExchangeError: It is no text, its rows differ in length, or a cell is no number.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            with path.open(encoding="utf-8-sig", newline="") as file:
                lines = [line for line in file if line.strip() and not line.startswith("#")]
        except (OSError, UnicodeError) as error:
            raise ExchangeError(f"{path}: no text in UTF-8 ({error}); save it as such") from error
        if not lines:
            raise ExchangeError(f"{path}: an empty table; give one line per row")
        if max(map(len, lines)) > _LONGEST_LINE:
            raise ExchangeError(f"{path}: a line is longer than {_LONGEST_LINE} characters")
        delimiter = next((each for each in _DELIMITERS if each in lines[0]), ",")
        try:
            cells = list(csv.reader(lines, delimiter=delimiter, strict=True))
        except csv.Error as error:
            raise ExchangeError(f'{path}: no table ({error}); quote texts by "') from error
        self.corner = ""
        self.columns: tuple[str, ...] = ()
        self.rows: tuple[str, ...] = ()
        if any(_number(cell) is None for cell in cells[0][1:]):
            self.corner, self.columns = cells[0][0].strip(), tuple(c.strip() for c in cells[0][1:])
            cells = cells[1:]
        if cells and all(_number(row[0]) is None for row in cells if row):
            self.rows = tuple(row[0].strip() for row in cells)
            cells = [row[1:] for row in cells]
        elif self.columns:  # a name above every column, none before the rows
            self.columns, self.corner = (self.corner, *self.columns), ""
        for names in (self.columns, self.rows):
            check_text(path, "the table", len(names), max(map(len, names), default=0))
        self.values = self._numbers(cells)

    @property
    def path(self) -> Path:
        """The file."""
        return self._path

    @property
    def units(self) -> str:
        """What stands in brackets in the first cell, as in `R [m/A]`."""
        _, bracket, rest = self.corner.partition("[")
        return rest.partition("]")[0].strip() if bracket else ""

    def listing(self) -> tuple[str, ...]:
        """Name what there is: the parts, and the columns."""
        parts = (VALUES, *((COLUMNS,) if self.columns else ()), *((ROWS,) if self.rows else ()))
        return (*parts, *self.columns)

    def get(self, where: str) -> Found:
        """Give a part (`values`, `columns`, `rows`) or one column by its name."""
        if where == VALUES:
            return Found(where, self.values, (), self.units)
        if where in (COLUMNS, ROWS) and (names := getattr(self, where)):
            return Found(where, np.empty(0), names)
        if where in self.columns:
            return Found(where, self.values[:, self.columns.index(where)])
        raise absent(self, where)

    def _numbers(self, cells: Sequence[Sequence[str]]) -> Vector:
        width = len(cells[0]) if cells else 0
        check_size(self._path, "the table", (len(cells), width), 8)
        if len(cells) * width * 8 > LARGEST_ARRAY or not width:
            raise ExchangeError(f"{self._path}: a table without numbers")
        values = np.empty((len(cells), width))
        for row, line in enumerate(cells):
            if len(line) != width or (self.columns and width != len(self.columns)):
                raise ExchangeError(
                    f"{self._path}: row {row + 1} of the numbers has {len(line)} cells, "
                    f"{len(self.columns) or width} are expected; fill in the missing ones, empty "
                    "where nothing was measured"
                )
            for column, cell in enumerate(line):
                number = _number(cell)
                if number is None:
                    raise ExchangeError(
                        f"{self._path}: row {row + 1}, column {column + 1} of the numbers is "
                        f"{cell[:40]!r}, no number; write 1.5e-3, with a point"
                    )
                values[row, column] = number
        return values


def _number(cell: str) -> float | None:
    """Read a cell; empty is NaN, and None is no number."""
    text = cell.strip()
    if not text:
        return math.nan
    try:
        return float(text) if "_" not in text else None
    except ValueError:
        return None
