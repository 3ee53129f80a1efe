"""A response cut into its planes, each solved by itself with a cut and a λ of its own.

What the correctors of one plane do in the other, R's blocks beside the diagonal, a law by planes
does not use: it is a disturbance that the other plane corrects. Whether the loop holds all the
same is asked of the whole response (`policies.stability`).
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from orbitfb.core.errors import ConfigError
from orbitfb.core.settings import Settings
from orbitfb.core.signals import Channels, Vector

Plane = Literal["x", "y"]


class PlaneLaw(Settings):
    """What the SVD law of one plane has of its own."""

    singular_values: int | None = Field(
        default=None, ge=1, description="Number of modes that are corrected [1]; unset: all."
    )
    regularisation: float | None = Field(
        default=None, ge=0.0, description="Tikhonov λ [m/A]; unset: policy.svd.regularisation."
    )
    bpms: int = Field(
        default=0, ge=0, description="BPMs of the plane [1]; the places table says it."
    )
    correctors: int = Field(
        default=0, ge=0, description="Correctors of the plane [1]; the places table says it."
    )


class PlaneDamping(Settings):
    """What the noise-aware law of one plane has of its own."""

    regularisation: float = Field(ge=0.0, description="Tikhonov λ [m/A].")
    correctors: int = Field(
        default=0, ge=0, description="Correctors of the plane [1]; the places table says it."
    )


@dataclass(frozen=True, slots=True)
class Block:
    """A part of R that is solved by itself.

    Args:
        rows: Its BPMs.
        columns: Its correctors.
        singular_values: Modes that are kept; None: all.
        regularisation: λ [m/A].
    """

    rows: slice
    columns: slice
    singular_values: int | None
    regularisation: float


def sized(laws: Mapping[Plane, PlaneLaw], channels: Channels) -> dict[Plane, PlaneLaw]:
    """Give a law for each plane of a loop, with the sizes of that plane.

    Args:
        laws: As configured; planes that are not named keep what holds for all.
        channels: Of the loop.

    Raises:
        ConfigError: The loop has no such plane.
    """
    planes = _planes_of(channels, laws, "svd")
    rows, columns = channels.bpm_parts, channels.corrector_parts
    return {
        plane: laws.get(plane, PlaneLaw()).model_copy(
            update={"bpms": _size(rows[plane]), "correctors": _size(columns[plane])}
        )
        for plane in planes
    }


def damped(
    planes: Mapping[Plane, PlaneDamping], usual: float, channels: Channels
) -> dict[Plane, PlaneDamping]:
    """Give the damping of each plane of a loop, with its correctors.

    Args:
        planes: As configured.
        usual: λ of planes that are not named [m/A].
        channels: Of the loop.

    Raises:
        ConfigError: The loop has no such plane.
    """
    both = _planes_of(channels, planes, "modal")
    parts, usually = channels.corrector_parts, PlaneDamping(regularisation=usual)
    return {
        plane: planes.get(plane, usually).model_copy(update={"correctors": _size(parts[plane])})
        for plane in both
    }


def damping_of(planes: Mapping[Plane, PlaneDamping], usual: float, columns: int) -> Vector:
    """Give λ of each corrector, shape (m,) [m/A].

    Args:
        planes: By plane, with their correctors; empty: all have the usual one.
        usual: λ [m/A].
        columns: Number of correctors m.

    Raises:
        ConfigError: The planes have another number of correctors.
    """
    if not planes:
        return np.full(columns, usual)
    told = sum(its.correctors for its in planes.values())
    if told != columns:
        raise ConfigError(
            f"policy.modal.planes is for {told} correctors, but the response matrix has {columns}: "
            "the policy is of another ring, or of other planes"
        )
    return np.concatenate([np.full(its.correctors, its.regularisation) for its in planes.values()])


def blocks_of(
    laws: Mapping[Plane, PlaneLaw],
    shape: tuple[int, ...],
    singular_values: int | None,
    regularisation: float,
) -> tuple[Block, ...]:
    """Cut a response.

    Args:
        laws: By plane, with their sizes; empty: the whole is one block.
        shape: Of the response, (n, m).
        singular_values: Modes that are kept of the whole; None: all.
        regularisation: λ where a plane has none of its own [m/A].

    Raises:
        ConfigError: The sizes do not make up the response, or more singular values are asked for
            than there are.
    """
    n, m = shape
    found: list[Block] = []
    row = column = 0
    for law in laws.values():
        rows, columns = slice(row, row + law.bpms), slice(column, column + law.correctors)
        row, column = rows.stop, columns.stop
        own = regularisation if law.regularisation is None else law.regularisation
        found.append(Block(rows, columns, law.singular_values, own))
    if not found:
        found.append(Block(slice(0, n), slice(0, m), singular_values, regularisation))
        row, column = n, m
    if (row, column) != (n, m):
        raise ConfigError(
            f"policy.svd.planes is for {row} BPMs and {column} correctors, but the response matrix "
            f"has {n} and {m}: the policy is of another ring, or of other planes"
        )
    for block, plane in zip(found, laws or ("",), strict=True):
        modes = min(_size(block.rows), _size(block.columns))
        if block.singular_values is not None and block.singular_values > modes:
            where = f"plane {plane} of the response matrix" if plane else "a response matrix"
            raise ConfigError(
                f"singular_values is {block.singular_values}, but {where} of shape "
                f"({_size(block.rows)}, {_size(block.columns)}) has only {modes}; lower it or "
                "leave it unset"
            )
    return tuple(found)


def within(blocks: tuple[Block, ...], matrix: Vector) -> Vector:
    """Take away what is beside the blocks, shape (n, m)."""
    kept = np.zeros_like(matrix)
    for block in blocks:
        kept[block.rows, block.columns] = matrix[block.rows, block.columns]
    return kept


def _planes_of(
    channels: Channels, named: Collection[Plane], law: Literal["svd", "modal"]
) -> tuple[Plane, ...]:
    """Planes of a loop in their order; those that are configured must be among them."""
    if unknown := [plane for plane in named if plane not in channels.planes]:
        raise ConfigError(
            f"policy.{law}.planes.{unknown[0]}: the loop has {channels.planes} only (ring.planes)"
        )
    planes: tuple[Plane, ...] = ("x", "y")
    return tuple(plane for plane in planes if plane in channels.planes)


def _size(part: slice) -> int:
    return int(part.stop - part.start)
