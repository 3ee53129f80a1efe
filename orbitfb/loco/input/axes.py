"""Find the device of every row and column of a measured response."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from orbitfb.core.errors import ExchangeError
from orbitfb.core.near_names import did_you_mean
from orbitfb.loco.input.labels import Place, labels
from orbitfb.loco.input.matrix import Raw
from orbitfb.loco.measured import PLANES
from orbitfb.physics.places import Kind, Plane, Planes, Ring, split

Channel = tuple[Plane, int]
"""Plane of a device, and its place in the table."""
_MOST_TOLD = 6
_MOST_UNKNOWN = 0.5
"""Share of names that the table may lack; beyond, the table is of another ring [1]."""
_AXES = ("rows", "columns")
_DEVICES = ("BPMs", "correctors")
_KINDS: tuple[Kind, Kind] = ("BPM", "COR")


@dataclass(frozen=True, slots=True)
class Axis:
    """Rows or columns of a matrix in a file, whose devices are looked for.

    Args:
        file: The file.
        raw: The matrix, its rows BPMs.
        number: 0 its rows, 1 its columns.
        planes: That it is of; None: as the names of its devices say.
        transposed: The rows of the file are correctors.
    """

    file: Path
    raw: Raw
    number: Literal[0, 1]
    planes: str | None
    transposed: bool

    @property
    def what(self) -> str:
        """What stands on it."""
        return _DEVICES[self.number]

    @property
    def plane(self) -> tuple[Plane, ...]:
        """Planes that its devices may be of; none: nothing says so."""
        if self.raw.pair:
            return (self.raw.pair[self.number],)
        return split(_planes_of(self.planes)) if self.planes else ()


def find_places(axis: Axis, ring: Ring, notes: list[str]) -> tuple[Channel | None, ...]:
    """Find plane and place of every row or column; None: the table lacks it.

    Args:
        axis: The rows or the columns.
        ring: The ring.
        notes: Takes what is to be said of them.

    Raises:
        ExchangeError: The devices cannot be told from each other or are of another ring.
    """
    names = (axis.raw.rows, axis.raw.columns)[axis.number]
    count = axis.raw.values.shape[axis.number]
    if not names:
        return _in_order(axis, count, ring, notes)
    if len(names) != count:
        raise ExchangeError(
            f"{axis.file}: {len(names)} names for {count} {axis.what} of {axis.raw.where}; name "
            "each once (--transpose, if its rows are correctors)"
        )
    known = labels(ring, _KINDS[axis.number])
    unknown = [name for name in names if name not in known]
    if len(unknown) > _MOST_UNKNOWN * count:
        raise _of_another_ring(axis, names, unknown, ring)
    found, elsewhere = _by_name(axis, names, known)
    for left_out, why in ((unknown, "the table lacks"), (elsewhere, "are of the other plane")):
        if left_out:
            told = ", ".join(left_out[:_MOST_TOLD]) + " …" * (len(left_out) > _MOST_TOLD)
            notes.append(f"{len(left_out)} {axis.what} that {why} are left out: {told}")
    seen = [its for its in found if its is not None]
    if len(set(seen)) != len(seen):
        twice = next(its for its in seen if seen.count(its) > 1)
        raise ExchangeError(
            f"{axis.file}: {ring.table.name[twice[1]]}:{twice[0]} is named twice among the "
            f"{axis.what}; leave one out"
        )
    return tuple(found)


def _in_order(axis: Axis, count: int, ring: Ring, notes: list[str]) -> tuple[Channel, ...]:
    """Give the places of devices without names: all of the table, in its order."""
    its_own = {p: ring.places(_KINDS[axis.number], p).tolist() for p in PLANES}
    chosen = axis.plane or PLANES
    if count == sum(len(its_own[p]) for p in chosen):
        notes.append(
            f"{axis.what}: no names; taken in the order of the places table, plane "
            f"{' then '.join(chosen)}"
        )
        return tuple((p, i) for p in chosen for i in its_own[p])
    there = " and ".join(f"{len(its_own[p])} {axis.what} in {p}" for p in PLANES)
    raise ExchangeError(
        f"{axis.file}: {axis.raw.where} has {count} {_AXES[axis.number]} without names; "
        f"the table has {there}; give --planes, --transpose, or names "
        f"({('--bpm-names', '--corrector-names')[axis.number]})"
    )


def _by_name(
    axis: Axis, names: Sequence[str], known: Mapping[str, Place]
) -> tuple[list[Channel | None], list[str]]:
    """Give the place of every name, and the names of devices of the other plane."""
    plane = axis.plane
    found: list[Channel | None] = []
    elsewhere: list[str] = []
    for name in names:
        its = known.get(name)
        if its is None:
            found.append(None)
        elif its[0] is not None and len(plane) == 1 and its[0] != plane[0]:
            elsewhere.append(name)
            found.append(None)
        elif its[0] is not None:
            found.append((its[0], its[1]))
        elif len(plane) == 1:
            found.append((plane[0], its[1]))
        else:
            raise ExchangeError(
                f"{axis.file}: {axis.what} {name!r} may be of either plane; name them NAME:x and "
                "NAME:y, or give --planes x or y"
            )
    return found, elsewhere


def _of_another_ring(
    axis: Axis, names: Sequence[str], unknown: Sequence[str], ring: Ring
) -> ExchangeError:
    """Say why most names are not in the table."""
    others = labels(ring, _KINDS[1 - axis.number])
    if sum(name in others for name in unknown) > _MOST_UNKNOWN * len(names):
        return ExchangeError(
            f"{axis.file}: the {_AXES[axis.number]} of {axis.raw.where} are "
            f"{_DEVICES[1 - axis.number]}, such as {unknown[0]!r}; "
            f"{'leave --transpose out' if axis.transposed else 'give --transpose'}"
        )
    hint = did_you_mean(unknown[0], labels(ring, _KINDS[axis.number]), most=1)
    return ExchangeError(
        f"{axis.file}: {len(unknown)} of {len(names)} {axis.what} are not in the places table, "
        f"such as {unknown[0]!r}{hint}; name its table with --places and --ring"
    )


def _planes_of(planes: str | None) -> Planes:
    return "x" if planes == "x" else "y" if planes == "y" else "xy"
