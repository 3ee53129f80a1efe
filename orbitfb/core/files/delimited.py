"""Tables of text as people and programs save them: one reader of cells for all of them.

Lines that begin with `#` or `%` are comments, empty lines are skipped, and what a comma at the end
of every line makes, an empty last column, is no column.
"""

import csv
from collections.abc import Sequence
from dataclasses import dataclass

from orbitfb.core.errors import OrbitFeedbackError

MARKS = ("#", "%")
"""What a comment begins with: that of numpy, pandas and the Data Browser, and that of MATLAB."""

MISSING = frozenset({"", "#n/a", "n/a", "na", "nan", "null", "none"})
"""Cells, in lower case, where nothing was measured."""

_DELIMITERS = ("\t", ";", ",")
_LONGEST_LINE = 2**22
_ANNOUNCED = "sep="


@dataclass(frozen=True, slots=True)
class Line:
    """One row of cells.

    Args:
        number: Of the line in the file, counted from 1.
        cells: Without blanks around them.
    """

    number: int
    cells: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Cells:
    """A table of text.

    Args:
        lines: Rows with at least one cell that is not empty.
        comment: The last comment above the rows, by cells; empty where there is none. Programs
            write the names of the columns there.
    """

    lines: tuple[Line, ...]
    comment: tuple[str, ...]


def read_cells(
    text: str, source: object, refuse: type[OrbitFeedbackError], delimiter: str = ""
) -> Cells:
    """Take a table apart.

    Args:
        text: The document, without a byte order mark.
        source: Name of the file, for messages.
        refuse: Error to raise.
        delimiter: Between cells; empty: a tab, a semicolon or a comma, whichever the first row
            has, in this order, or else blanks.
    """
    kept: list[tuple[int, str]] = []
    comment = ""
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    for number, line in enumerate(lines, 1):
        if len(line) > _LONGEST_LINE:
            raise refuse(f"{source}: line {number} is longer than {_LONGEST_LINE} characters")
        stripped = line.strip()
        if stripped.startswith(MARKS) and not stripped.lower().startswith("#n/a"):
            comment = comment if kept else stripped.lstrip("".join(MARKS)).strip()
        elif not kept and stripped.lower().startswith(_ANNOUNCED) and len(stripped) == 5:
            delimiter = delimiter or stripped[-1]  # as Excel writes it
        elif stripped.strip(",;"):
            kept.append((number, line))
    found = delimiter or next((each for each in _DELIMITERS if kept and each in kept[0][1]), "")
    try:
        rows = [Line(number, _split(line, found)) for number, line in kept]
        above = _split(comment, found) if comment else ()
    except csv.Error as error:
        raise refuse(f'{source}: no table ({error}); quote texts by "') from error
    return Cells(tuple(_without_empty_ends(rows)), above)


def _split(line: str, delimiter: str) -> tuple[str, ...]:
    if not delimiter:
        return tuple(line.split())
    row = next(csv.reader([line], delimiter=delimiter, strict=True))
    return tuple(cell.strip() for cell in row)


def _without_empty_ends(rows: Sequence[Line]) -> Sequence[Line]:
    """Leave out last columns that are empty in every row that has them."""
    width = max((len(row.cells) for row in rows), default=0)
    while width > 1 and all(len(row.cells) < width or not row.cells[-1] for row in rows):
        width -= 1
        rows = [Line(row.number, row.cells[:width]) for row in rows]
    return rows
