"""Read a table of numbers from CSV: names above the columns, names before the rows, or neither."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from orbitfb.core.errors import ExchangeError
from orbitfb.core.files.bounded import read_text
from orbitfb.core.files.delimited import MISSING, Line, read_cells
from orbitfb.core.signals import Vector
from orbitfb.exchange.formats.datasets import LARGEST_FILE, Found, absent, check_size, check_text
from orbitfb.exchange.times import is_time

COLUMNS, ROWS, VALUES = "columns", "rows", "values"
"""The paths within a CSV file: names above, names before, the numbers."""


class CsvSource:
    """A CSV file, delimited by tabs, semicolons, commas or blanks.

    Lines that begin with # or % are comments; the last one above the table names its columns where
    the table itself does not, and it has as many cells.

    Args:
        path: The file.

    Raises:
        ExchangeError: It is no text, its rows differ in length, or a cell is no number.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        text = read_text(path, LARGEST_FILE, ExchangeError, "name a table of text")
        table = read_cells(text, path, ExchangeError)
        if not table.lines:
            raise ExchangeError(f"{path}: an empty table; give one line per row")
        lines = table.lines
        head = lines[0].cells
        self.corner = ""
        self.columns: tuple[str, ...] = ()
        self.rows: tuple[str, ...] = ()
        if any(_is_name(cell) for cell in head[1:]):
            lines = lines[1:]
        else:  # a comment that names every column is the head
            head = table.comment if len(table.comment) == len(head) > 1 else ()
        if head:
            self.corner, self.columns = head[0], head[1:]
        self._first = int(bool(lines) and all(_is_name(row.cells[0]) for row in lines))
        if self._first:
            self.rows = tuple(row.cells[0] for row in lines)
        elif self.columns:  # a name above every column, none before the rows
            self.columns, self.corner = (self.corner, *self.columns), ""
        for names in (self.columns, self.rows):
            check_text(path, "the table", len(names), max(map(len, names), default=0))
        self.times: dict[int, tuple[str, ...]] = {}
        self.values = self._numbers(lines)

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
            column = self.columns.index(where)
            return Found(where, self.values[:, column], self.times.get(column, ()))
        raise absent(self, where)

    def _numbers(self, lines: Sequence[Line]) -> Vector:
        width = len(lines[0].cells) - self._first if lines else 0
        check_size(self._path, "the table", (len(lines), width), 8)
        if not width:
            raise ExchangeError(f"{self._path}: a table without numbers")
        values = np.empty((len(lines), width))
        for row, line in enumerate(lines):
            cells = line.cells[self._first :]
            if len(cells) != width or (self.columns and width != len(self.columns)):
                raise ExchangeError(
                    f"{self._path}, line {line.number}: {len(cells)} cells, "
                    f"{len(self.columns) or width} are expected; fill in the missing ones, empty "
                    "where nothing was measured"
                )
            for column, cell in enumerate(cells):
                number = _number(cell)
                if number is not None:
                    values[row, column] = number
                elif is_time(cell):
                    values[row, column] = math.nan
                    self.times[column] = ()
                else:
                    raise ExchangeError(
                        f"{self._path}, line {line.number}, column {column + 1 + self._first}: "
                        f"{cell[:40]!r} is no number; write 1.5e-3, with a point"
                    )
        for column in self.times:
            self.times[column] = tuple(line.cells[column + self._first] for line in lines)
        return values


def _is_name(cell: str) -> bool:
    return _number(cell) is None and not is_time(cell)


def _number(cell: str) -> float | None:
    """Read a cell; one where nothing was measured is NaN, and None is no number."""
    if cell.lower() in MISSING:
        return math.nan
    try:
        return float(cell) if "_" not in cell else None
    except ValueError:
        return None
