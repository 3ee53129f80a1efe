"""Groups of devices that an effect may strike alike."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices


def groups_of(
    cells: Mapping[str, Indices], count: int, planes: Sequence[str]
) -> Iterator[tuple[str, Indices]]:
    """List groups that an effect may strike: all, a plane, runs of neighbouring cells.

    Args:
        cells: Columns of every cell, in order around the ring.
        count: Of all columns.
        planes: Of every column.
    """
    everything = np.arange(count, dtype=np.intp)
    yield "all", everything
    of_plane = {p: everything[np.array([q == p for q in planes])] for p in sorted(set(planes))}
    if len(of_plane) > 1:
        yield from ((f"all {plane}", members) for plane, members in of_plane.items())
    names = list(cells)
    for begin in range(len(names)):
        for end in range(begin + 1, min(begin + 1 + len(names) // 2, len(names) + 1)):
            members = np.concatenate([cells[name] for name in names[begin:end]])
            if len(members) < 2:
                continue
            label = names[begin] if end == begin + 1 else f"{names[begin]}–{names[end - 1]}"
            yield label, members
            if len(of_plane) > 1:
                for plane in of_plane:
                    own = members[np.array([planes[int(i)] == plane for i in members])]
                    if len(own) > 1:
                        yield f"{label} {plane}", own


def membership(groups: Sequence[tuple[str, Indices]], count: int) -> Matrix:
    """Tell who is in which group: 1 for a member, shape (groups, count).

    Args:
        groups: With names, as `groups_of` lists them.
        count: Of all columns.
    """
    member = np.zeros((len(groups), count))
    for row, (_, columns) in enumerate(groups):
        member[row, columns] = 1.0
    return member
