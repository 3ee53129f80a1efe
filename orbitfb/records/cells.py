"""Which devices stand together: the cell of each, from what it is called."""

import re
from collections.abc import Sequence

_CELL = re.compile(r"(?:^|[^A-Za-z0-9])(C\d{1,3})(?=$|[^A-Za-z0-9])")
_NUMBER = re.compile(r"[A-Za-z]*\d+")
_FEWEST = 3
"""Cells that a ring has at least."""


def cell_of(name: str) -> str:
    """Tell the cell from a name, `PH1A_C30` → `C30`; empty when it does not say."""
    found = _CELL.search(name)
    return found[1] if found else ""


def cells_of(names: Sequence[str], planes: Sequence[str]) -> tuple[str, ...]:
    """Tell the cells from names, in the order of the ring.

    Where none says `C30`, the number in the names that neighbours share and others do not is
    that of the cell, with the letters before it: `SR03-BPM-1`, `SR03-BPM-2`, … are in `SR03`.

    Args:
        names: Of k columns.
        planes: Of k columns; the order counts within each.

    Returns:
        One for every name; all empty when the names do not say.
    """
    told = tuple(map(cell_of, names))
    if any(told):
        return told
    numbers = [_NUMBER.findall(name) for name in names]
    most = max((len(found) for found in numbers), default=0)
    best = told
    for index in range(-most, most):
        own = tuple(found[index] if -len(found) <= index < len(found) else "" for found in numbers)
        of_planes = [
            [label for label, its in zip(own, planes, strict=True) if its == plane]
            for plane in sorted(set(planes))
        ]
        if len(set(own)) > len(set(best)) and all(map(_are_cells, of_planes)):
            best = own
    return best


def _are_cells(labels: Sequence[str]) -> bool:
    """Whether every label belongs to one run of neighbours; a ring may begin within a cell."""
    different = len(set(labels))
    runs = sum(one != labels[index - 1] for index, one in enumerate(labels))
    return "" not in labels and _FEWEST <= different == runs <= len(labels) / 2
