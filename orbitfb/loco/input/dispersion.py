"""The measured horizontal dispersion beside a response: the column of the RF."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from orbitfb.core.errors import ExchangeError
from orbitfb.core.signals import Vector
from orbitfb.exchange.formats.csv_file import ROWS, VALUES, CsvSource
from orbitfb.exchange.formats.source import open_source
from orbitfb.exchange.units import ORBIT, factor
from orbitfb.loco.input.labels import Place
from orbitfb.loco.input.matrix import Raw
from orbitfb.physics.places import Indices, Plane, Ring


def of_blocks(
    blocks: Sequence[tuple[Raw, Sequence[tuple[Plane, int] | None]]], bpms: Indices, ring: Ring
) -> Vector | None:
    """Take the dispersion that stands beside a matrix, shape (n,) [m]; None: there is none.

    An orbit change Δx by a change Δf of the RF frequency is −η/α_c · Δf/f.

    Args:
        blocks: Matrices of the file, each with plane and place of its rows.
        bpms: Horizontal ones, places in the table, shape (n,).
        ring: The ring, for α_c.

    Raises:
        ExchangeError: It has another length than the matrix has rows.
    """
    found = np.full(len(bpms), np.nan)
    row_of = {int(place): number for number, place in enumerate(bpms)}
    for raw, rows in blocks:
        if raw.dispersion is None:
            continue
        horizontal = [k for k, its in enumerate(rows) if its is not None and its[0] == "x"]
        if len(raw.dispersion) != len(rows):
            raise ExchangeError(
                f"the dispersion beside {raw.where} has {len(raw.dispersion)} values for "
                f"{len(rows)} rows; give one for each row, NaN where it was not measured"
            )
        size = -ring.parameters.alpha_c if raw.by_frequency else 1.0
        for k in horizontal:
            its = rows[k]
            if its is not None:
                found[row_of[its[1]]] = size * raw.dispersion[k]
    return found if np.isfinite(found).any() else None


def of_file(path: Path, bpms: Indices, known: Mapping[str, Place]) -> Vector:
    """Read a table of names and values, unit in the first line: `bpm,dispersion [m]`.

    Args:
        path: A table of text.
        bpms: Horizontal ones, places in the table, shape (n,).
        known: Places of the names of the ring.

    Returns:
        Shape (n,) [m]; NaN where the table says nothing.

    Raises:
        ExchangeError: It is no such table, or of another ring.
    """
    source = open_source(path)
    if not isinstance(source, CsvSource) or not source.rows or len(source.columns) != 1:
        raise ExchangeError(
            f"{path}: the dispersion is a table of text with a name and a value in each line, "
            "below `bpm,dispersion [m]`"
        )
    told = source.units or source.columns[0].partition("[")[2].partition("]")[0]
    _, size = factor(None, told, ORBIT, f"{path}: the dispersion", "its first line")
    row_of = {int(place): number for number, place in enumerate(bpms)}
    found = np.full(len(bpms), np.nan)
    names = source.get(ROWS).texts
    for name, value in zip(names, source.get(VALUES).numbers[:, 0], strict=True):
        its = known.get(name)
        if its is not None and its[0] != "y" and its[1] in row_of:
            found[row_of[its[1]]] = size * value
    if not np.isfinite(found).any():
        raise ExchangeError(
            f"{path}: none of its {len(names)} names is a horizontal BPM of the response; see "
            "--places, and the names"
        )
    return found
