"""What is said of a foreign response matrix, and the table that is made of it."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from orbitfb.core.errors import ExchangeError
from orbitfb.core.signals import Channels
from orbitfb.exchange.formats.csv_file import COLUMNS, ROWS, VALUES, CsvSource
from orbitfb.exchange.formats.datasets import Found, Source, matrix_of
from orbitfb.exchange.formats.source import names_from
from orbitfb.exchange.naming import bpm_labels, corrector_labels, places_or_none
from orbitfb.exchange.response.middle_layer import block_of, is_middle_layer
from orbitfb.measure.column import Table
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices, Planes

ORDERS = ("names", "table")


@dataclass(frozen=True, slots=True)
class ResponseRequest:
    """What the caller says of a file.

    Args:
        file: The file.
        out: Where the measured response is to be.
        matrix: Path of the matrix within the file; None: the only place that a CSV file has.
        bpm_names: Path of the names of the BPMs, or @FILE; None: those of the table, if CSV.
        corrector_names: Names of the correctors, in the same way.
        order: `names`, or `table`: rows and columns stand in the order of the places table.
        unit: Of the matrix; None: as the file says.
        sigma: Path of the standard deviations, in the same unit; None: not known.
        transpose: Rows are correctors.
        anyway: Take it although it is not plausible.
    """

    file: Path
    out: Path
    matrix: str | None = None
    bpm_names: str | None = None
    corrector_names: str | None = None
    order: str = "names"
    unit: str | None = None
    sigma: str | None = None
    transpose: bool = False
    anyway: bool = False


def found_in(source: Source, where: str | None, planes: Planes) -> Found:
    """Read the matrix as it stands.

    Args:
        source: The file.
        where: Path of the matrix within it; None: the only place of its format.
        planes: `x`, `y` or `xy`, for files that hold them apart.

    Raises:
        ExchangeError: Nobody says where it is, or it is not there.
    """
    if where is None and not isinstance(source, CsvSource):
        if is_middle_layer(source):
            return _middle_layer(source, planes)
        raise ExchangeError(
            f"{source.path}: --matrix must say which of these is the matrix: "
            f"{', '.join(source.listing()[:30])}"
        )
    return source.get(where or VALUES)


def _middle_layer(source: Source, planes: Planes) -> Found:
    """Read `Rmat` of the Matlab Middle Layer, the blocks of the planes one beside the other.

    A file of one block is of the plane that the caller says.
    """
    blocks = {(i, j): block_of(source, i, j) for i in (1, 2) for j in (1, 2)}
    first, last = blocks[1, 1], blocks[2, 2]
    if first is None:
        return source.get("Rmat.Data")
    if planes == "x" or (last is None and planes == "y"):
        return replace(first[0], numbers=first[1])
    if last is None:
        raise ExchangeError(
            f"{source.path}: Rmat has one block, and planes x and y are asked for; give the plane "
            "that it is of with --planes"
        )
    if planes == "y":
        return replace(last[0], numbers=last[1])
    (n, m), (more, others) = first[1].shape, last[1].shape
    whole = np.zeros((n + more, m + others))
    rows, columns = (slice(0, n), slice(n, None)), (slice(0, m), slice(m, None))
    for (i, j), its in blocks.items():
        if its is not None:
            whole[rows[i - 1], columns[j - 1]] = its[1]
    return Found("Rmat", whole, (), first[0].units)


def places_in(
    source: Source, request: ResponseRequest, matrix: Matrix, channels: Channels
) -> tuple[Indices, Indices, tuple[str, ...]]:
    """Find the places of rows and columns in the ring, of the matrix as it is in the end.

    Returns:
        Places of rows and of columns, −1 where the ring lacks the device, and the names of those.

    Raises:
        ExchangeError: Nobody says which devices they are, or they are not of the ring.
    """
    if request.transpose:
        matrix = matrix.T
    n, m = len(channels.bpms), len(channels.correctors)
    unnamed = request.bpm_names is None and request.corrector_names is None
    numbered = unnamed and request.matrix is None and is_middle_layer(source)
    if request.order == "table" or (numbered and matrix.shape == (n, m)):
        if matrix.shape != (n, m):
            turned = matrix.shape == (m, n) and n != m
            advice = "give --transpose" if turned else "give the names, or the planes that it is of"
            raise ExchangeError(
                f"{source.path}: the matrix has shape {matrix.shape}, the ring has {n} BPMs and "
                f"{m} correctors in planes {channels.planes}; {advice}"
            )
        return np.arange(n), np.arange(m), ()
    found: list[Indices] = []
    lacking: list[str] = []
    for where, part, option, what, known in (
        (request.bpm_names, ROWS, "--bpm-names", "BPMs", bpm_labels(channels)),
        (request.corrector_names, COLUMNS, "--corrector-names", "correctors",
         corrector_labels(channels)),
    ):  # fmt: skip
        if where is None and isinstance(source, CsvSource):
            part = {ROWS: COLUMNS, COLUMNS: ROWS}[part] if request.transpose else part
            where = part if getattr(source, part) else None
        if where is None:
            raise ExchangeError(
                f"{source.path}: nothing says which {what} these are, and the order is not "
                f"guessed; give {option} (a path within the file, or @FILE with one name per "
                "line), or --order table if they stand in the order of the places table"
            )
        names = names_from(source, where)
        length = matrix.shape[len(found)]
        if len(names) != length:
            turned = len(names) == matrix.shape[1 - len(found)]
            raise ExchangeError(
                f"{source.path}: {len(names)} {what} for the {length} "
                f"{('rows', 'columns')[len(found)]} of a matrix of shape {matrix.shape}; "
                + ("the matrix is transposed: " if turned else "")
                + ("leave --transpose out" if turned and request.transpose else
                   "give --transpose" if turned else "name each of them once")
            )  # fmt: skip
        places, unknown = places_or_none(names, known, what, source.path)
        found.append(places)
        lacking += unknown
    return found[0], found[1], tuple(lacking)


def table_of(
    source: Source,
    request: ResponseRequest,
    found: Found,
    channels: Channels,
    rows: Indices,
    columns: Indices,
) -> Table:
    """Put the numbers where they belong, in the unit of the file; what it lacks is NaN.

    Raises:
        ExchangeError: The standard deviations have another shape.
    """
    table = Table.empty(len(channels.bpms), len(channels.correctors))
    for name, part in (("response", found), ("sigma", _sigma(source, request.sigma))):
        if part is None:
            continue
        numbers = matrix_of(part, source.path)
        numbers = numbers.T if request.transpose else numbers
        if numbers.shape != (len(rows), len(columns)):
            raise ExchangeError(
                f"{source.path}: {part.where} has shape {numbers.shape}, the matrix "
                f"{(len(rows), len(columns))}; give one number for each"
            )
        inside = np.ix_(rows >= 0, columns >= 0)
        getattr(table, name)[np.ix_(rows[rows >= 0], columns[columns >= 0])] = np.where(
            np.isfinite(numbers), numbers, np.nan
        )[inside]
    measured = np.isfinite(table.response).any(axis=0)
    table.time[measured] = source.path.stat().st_mtime
    return table


def _sigma(source: Source, where: str | None) -> Found | None:
    return None if where is None else source.get(where)
