"""`Rmat` of the Matlab Middle Layer: blocks whose devices have numbers and no names."""

import numpy as np

from orbitfb.core.errors import ExchangeError
from orbitfb.exchange.formats.datasets import Found, Source, matrix_of
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices


def is_middle_layer(source: Source) -> bool:
    """Tell whether a file has an `Rmat`."""
    return any(name.startswith("Rmat.") for name in source.listing())


def block_of(source: Source, row: int, column: int) -> tuple[Found, Matrix] | None:
    """Read one block, its devices in the order of their numbers [sector, device].

    Args:
        source: The file.
        row: Plane of the BPMs, from 1.
        column: Plane of the correctors, from 1.

    Returns:
        As it is found, and its numbers in that order; None where it is absent or empty.

    Raises:
        ExchangeError: It is no matrix.
    """
    where = f"Rmat({row},{column})"
    try:
        found = source.get(f"{where}.Data")
    except ExchangeError:
        return None
    if not found.numbers.size:
        return None
    values = matrix_of(found, source.path)
    rows = _order(source, f"{where}.Monitor.DeviceList", values.shape[0])
    columns = _order(source, f"{where}.Actuator.DeviceList", values.shape[1])
    return found, values[np.ix_(rows, columns)]


def _order(source: Source, where: str, count: int) -> Indices:
    """Sort by sector and device; as it stands where the file has no such list."""
    try:
        numbers = np.asarray(source.get(where).numbers, dtype=np.float64)
    except (ExchangeError, TypeError, ValueError):
        return np.arange(count)
    if numbers.shape != (count, 2):
        return np.arange(count)
    return np.lexsort((numbers[:, 1], numbers[:, 0]))
