"""The file of a measured response matrix, and what of it may be adopted."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orbitfb.core.errors import RingError
from orbitfb.core.signals import COUNTS, Channels, Mask, Vector
from orbitfb.measure.column import Table, table_shapes
from orbitfb.measure.judging import Judgement, labels
from orbitfb.measure.packed import read_packed, write_packed
from orbitfb.physics.places import Planes, Ring
from orbitfb.physics.response import response
from orbitfb.policies.masking import MaskSettings, mask_of

_KIND = "response"
_ADVICE = "measure it with `orbitfb measure-response`, or leave its key out"


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredResponse:
    """A measured matrix as its file has it.

    Args:
        table: Its columns, NaN where nothing was measured.
        base: Setpoints around which it was measured, shape (m,) [A].
        card: Names, flags, settings.
    """

    table: Table
    base: Vector
    card: dict[str, Any]


def write_response(
    path: Path,
    table: Table,
    base: Vector,
    channels: Channels,
    judgement: Judgement,
    about: Mapping[str, Any],
) -> None:
    """Write a finished measurement.

    Args:
        path: The file.
        table: Its columns.
        base: Setpoints around which it was measured, shape (m,) [A].
        channels: Of the ring.
        judgement: What of it is not to be used.
        about: More for the card; only what JSON can say.

    Raises:
        MeasurementError: It cannot be written.
    """
    card = {
        "kind": _KIND,
        "planes": channels.planes,
        **{word: counts for word in COUNTS if (counts := getattr(channels, word))},
        "bpms": channels.bpms,
        "correctors": channels.correctors,
        "bad_bpms": judgement.bpms,
        "bad_correctors": judgement.correctors,
        "not_measured": judgement.missing,
        **about,
    }
    write_packed(path, {**table.tensors(), "base": base}, card)


def read_response(path: Path, channels: Channels) -> MeasuredResponse:
    """Read a measured matrix.

    Args:
        path: The file.
        channels: Of the ring.

    Raises:
        RingError: It is missing, damaged, or of another ring.
    """
    tensors, card = read_packed(path, _KIND, _ADVICE, RingError)
    n, m = len(channels.bpms), len(channels.correctors)
    if {name: array.shape for name, array in tensors.items()} != {
        **table_shapes(n, m),
        "base": (m,),
    }:
        raise RingError(
            f"{path} does not hold the arrays of {n} BPMs and {m} correctors; {_ADVICE}"
        )
    for key in ("planes", "bpms", "correctors"):
        here = getattr(channels, key)
        if card.get(key) != (here if key == "planes" else list(here)):
            raise RingError(f"{path} has other {key} than the configured ring; {_ADVICE}")
    return MeasuredResponse(Table.of(tensors), tensors["base"], card)


def adopted(
    measured: MeasuredResponse, path: Path, channels: Channels, counting: Mask, movable: Mask
) -> Vector:
    """Give the matrix for a loop: whatever is bad or missing must be masked, and is 0.

    Args:
        measured: The matrix.
        path: Its file, for messages.
        channels: Of the ring.
        counting: BPMs that are not masked, shape (n,).
        movable: Correctors that are not masked, shape (m,).

    Returns:
        R, shape (n, m) [m/A].

    Raises:
        RingError: Something that is not masked was not measured, or is bad.
    """
    bad = measured.card.get("bad_correctors", {})
    problems = [
        (f"masks.correctors {label!r}", str(bad.get(label, "was not measured")))
        for label, wanted, done in zip(
            labels(channels.correctors, channels.corrector_planes),
            movable,
            measured.table.measured,
            strict=True,
        )
        if wanted and (label in bad or not done)
    ]
    bad = measured.card.get("bad_bpms", {})
    problems += [
        (f"masks.bpms {label!r}", str(bad[label]))
        for label, wanted in zip(labels(channels.bpms, channels.bpm_planes), counting, strict=True)
        if wanted and label in bad
    ]
    matrix = np.where(np.outer(counting, movable), measured.table.response, 0.0)
    if problems:
        told = "\n".join(f"  {label}: {problem}" for label, problem in problems[:10])
        more = f"\n  and {len(problems) - 10} more" if len(problems) > 10 else ""
        raise RingError(
            f"the response matrix {path} is not adopted, {len(problems)} of its columns and rows "
            f"are not to be used:\n{told}{more}\n"
            "repair them and measure again, or mask them in the configuration"
        )
    if not np.isfinite(matrix).all():
        raise RingError(f"the response matrix {path} is not finite; {_ADVICE}")
    return matrix


def nominal_response(
    ring: Ring, planes: Planes, measured: Path | None, masks: MaskSettings
) -> Vector:
    """Give the response that a loop begins with: measured, or by the optics.

    Args:
        ring: The ring.
        planes: `x`, `y` or `xy`.
        measured: File of a measured matrix; None: the optics.
        masks: What is not used.

    Returns:
        R, shape (n, m) [m/A].

    Raises:
        RingError: The file cannot be adopted.
        ConfigError: A mask names what the ring does not have.
    """
    if measured is None:
        return response(ring, planes)
    channels = ring.channels(planes)
    counting, movable = mask_of(channels, masks)
    return adopted(read_response(measured, channels), measured, channels, counting, movable)
