"""Groups of devices that an effect may strike alike."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Devices

_RACK = 8
"""Neighbouring devices that may share a rack which does not begin with a cell."""
_ACROSS = 0.2
"""Probability that what strikes several neighbours does not keep to cells."""
_ALL_LENGTHS = 40
"""Cells up to which runs of every length are groups; of more, those that grow by about a third."""


class Group(NamedTuple):
    """Devices that an effect may strike alike.

    Args:
        name: All, a plane, a run of cells or a rack across them.
        members: Columns of the devices, in order.
        choices: Of how many alike it is one; the inverse of its probability before the data.
    """

    name: str
    members: Indices
    choices: float


@lru_cache(maxsize=8)
def groups_of(devices: Devices) -> tuple[Group, ...]:
    """List groups that an effect may strike: all, a plane, runs of cells, racks across them.

    Where no name tells a cell every device is one.

    Args:
        devices: In order around the ring.
    """
    everything = np.arange(len(devices), dtype=np.intp)
    planes = np.array(devices.planes)
    split = sorted(set(devices.planes)) if len(set(devices.planes)) > 1 else []
    known, each = devices.groups(), _one_by_one(devices)
    whole = [("all", everything), *((f"all {p}", everything[planes == p]) for p in split)]
    racks: list[tuple[str, Indices]] = []
    seen = {tuple(members.tolist()) for _, members in whole}
    runs = [(whole, run) for run in _runs(known or each, _lengths(len(known or each)))]
    if known:
        rings = _rings(each, devices) if split else [each]
        runs += [(racks, run) for ring in rings for run in _runs(ring, range(2, _RACK + 1))]
    for kind, (label, members) in runs:
        of_plane = [(f"{label} {p}", members[planes[members] == p]) for p in split]
        for name, own in (
            (label, members),
            *(one for one in of_plane if len(one[1]) < len(members)),
        ):
            if len(own) > 1 and (key := tuple(own.tolist())) not in seen:
                seen.add(key)
                kind.append((name, own))
    for _, members in (*whole, *racks):
        members.setflags(write=False)  # they are remembered
    shares = ((whole, 1.0 - _ACROSS if racks else 1.0), (racks, _ACROSS))
    return tuple(
        Group(name, members, len(kind) / share) for kind, share in shares for name, members in kind
    )


def _rings(each: Mapping[str, Indices], devices: Devices) -> list[Mapping[str, Indices]]:
    """Devices around the ring; plane by plane where those of one come after the other's."""
    planes = [devices.planes[columns[0]] for columns in each.values()]
    both = any(len(columns) > 1 for columns in each.values())
    turns = sum(one != other for one, other in pairwise(planes))
    if both or turns >= len(set(planes)):
        return [each]
    return [
        {name: own for name, own in each.items() if devices.planes[own[0]] == plane}
        for plane in sorted(set(planes))
    ]


def _runs(units: Mapping[str, Indices], lengths: Iterable[int]) -> Iterator[tuple[str, Indices]]:
    """Runs of neighbouring units around the ring, of some lengths up to half of them."""
    names, columns = list(units), list(units.values())
    count = len(names)
    for begin in range(count):
        for length in lengths:
            if length > max(count // 2, 1):
                break
            its = [(begin + far) % count for far in range(length)]
            label = names[begin] if length == 1 else f"{names[begin]}–{names[its[-1]]}"
            yield label, np.sort(np.concatenate([columns[index] for index in its]))


def each_alone(count: int) -> list[Group]:
    """List so many devices, or other places, each by itself and without a name."""
    return [Group("", np.array([place]), float(count)) for place in range(count)]


def crates(devices: Devices) -> list[Group]:
    """List those of at most half of the devices: what most do is no fault of theirs.

    Args:
        devices: In order around the ring.
    """
    return [group for group in groups_of(devices) if 2 * len(group.members) <= len(devices)]


def cells(devices: Devices) -> list[Indices]:
    """Columns of every cell; of every run of four devices, half over the next, if none is known."""
    known = list(devices.groups().values())
    if known:
        return known
    each = list(_one_by_one(devices).values())
    return [np.concatenate(each[begin : begin + 4]) for begin in range(0, len(each) - 1, 2)]


def membership(groups: Sequence[Group], count: int) -> Matrix:
    """Tell who is in which group: 1 for a member, shape (groups, count).

    Args:
        groups: As `groups_of` lists them.
        count: Of all columns.
    """
    member = np.zeros((len(groups), count))
    for row, group in enumerate(groups):
        member[row, group.members] = 1.0
    return member


def _one_by_one(devices: Devices) -> dict[str, Indices]:
    """Columns of every device, both planes together."""
    found: dict[str, list[int]] = {}
    for column, name in enumerate(devices.names):
        found.setdefault(name, []).append(column)
    return {name: np.array(columns, dtype=np.intp) for name, columns in found.items()}


def _lengths(count: int) -> list[int]:
    """Lengths of runs of cells, up to half of them."""
    most = max(count // 2, 1)
    if count <= _ALL_LENGTHS:
        return list(range(1, most + 1))
    lengths = [1]
    while (longer := lengths[-1] + max(lengths[-1] // 3, 1)) <= most:
        lengths.append(longer)
    return lengths
