"""What operators have set, on disk: a whole file or the one before, restored at the next start.

The state of the loop is not in it: a loop never closes because it was closed before.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
from pydantic import Field, ValidationError

from orbitfb.core.errors import ConfigError, OrbitFeedbackError
from orbitfb.core.files.state import make_directory, replace_file
from orbitfb.core.settings import Settings
from orbitfb.core.signals import Channels, Mask

S = TypeVar("S", bound=Settings)

FILE = "operator.json"
LARGEST = 1 << 22
"""Longest file that is read [bytes]."""


class SavedBump(Settings):
    """A closed bump that is part of the reference."""

    place: str = Field(description="Where, as it was asked for.")
    plane: str = Field(description="x or y.")
    position: float = Field(description="Of the orbit there [m].")
    angle: float = Field(description="Of the orbit there [rad].")
    orbit: tuple[float, ...] = Field(description="Its part of the reference [m].")
    setpoints: tuple[float, ...] = Field(description="Setpoints that make it, about [A].")


class Saved(Settings):
    """What operators have set."""

    schema_version: int = Field(default=1, ge=1, le=1, description="Version of the layout.")
    planes: str = Field(description="Planes under feedback.")
    gain: dict[str, float] = Field(description="Factor of the policy's change by plane [1].")
    reference: tuple[float, ...] = Field(description="Reference orbit, x first, then y [m].")
    reference_name: str = Field(default="", description="Name of the reference; empty: none.")
    average: int | None = Field(
        default=None, ge=1, description="Orbits that are averaged; none: as configured."
    )
    dead_band: dict[str, float] | None = Field(
        default=None, description="Dead band by plane [m]; none: as configured."
    )
    bumps: tuple[SavedBump, ...] = Field(default=(), description="Bumps in that reference.")
    disabled_bpms: tuple[str, ...] = Field(default=(), description="NAME:plane each.")
    disabled_correctors: tuple[str, ...] = Field(default=(), description="NAME:plane each.")
    dither: float | None = Field(
        default=None, ge=0, description="Orbit motion by the dither [m]; none: as configured."
    )


class Reference(Settings):
    """A reference orbit on disk."""

    schema_version: int = Field(default=1, ge=1, le=1, description="Version of the layout.")
    bpms: tuple[str, ...] = Field(description="NAME:plane each, in the order of the positions.")
    position: tuple[float, ...] = Field(description="Reference orbit [m].")


def labels(names: Sequence[str], planes: Sequence[str]) -> tuple[str, ...]:
    """Give every element of a vector a name of its own, `NAME:plane`.

    Args:
        names: Of its devices.
        planes: Of each of them.
    """
    return tuple(f"{name}:{plane}" for name, plane in zip(names, planes, strict=True))


def fits(saved: Saved, channels: Channels, largest_gain: float) -> bool:
    """Say whether what was saved is of this ring and within its limits.

    Args:
        saved: As read.
        channels: Of the loop.
        largest_gain: That operators may set.
    """
    bpms = labels(channels.bpms, channels.bpm_planes)
    correctors = labels(channels.correctors, channels.corrector_planes)
    unknown = {*saved.disabled_bpms} - {*bpms} | {*saved.disabled_correctors} - {*correctors}
    planes, sizes = {*channels.planes}, (len(bpms), len(correctors))
    return (
        saved.planes == channels.planes
        and len(saved.reference) == len(bpms)
        and all((len(bump.orbit), len(bump.setpoints)) == sizes for bump in saved.bumps)
        and saved.gain.keys() == planes
        and all(0 <= gain <= largest_gain for gain in saved.gain.values())
        and (saved.dead_band is None or saved.dead_band.keys() == planes)
        and not unknown
    )


def read_saved(directory: Path, channels: Channels, largest_gain: float) -> Saved | None:
    """Read what operators had set; None: nothing was saved.

    Args:
        directory: Data directory.
        channels: Of the loop.
        largest_gain: Largest gain that is accepted.

    Raises:
        ConfigError: It is damaged, or of another ring.
    """
    path = directory / FILE
    if not path.exists():
        return None
    advice = "it holds what operators had set; repair it, or remove it and set it again"
    saved = read_whole(path, Saved, advice)
    if not fits(saved, channels, largest_gain):
        raise ConfigError(f"{path}: is of another ring or other planes; {advice}")
    return saved


def all_but(names: Sequence[str], planes: Sequence[str], off: Sequence[str]) -> Mask:
    """Give the devices that are not among some, `NAME:plane` each, shape (k,)."""
    return np.array([its not in off for its in labels(names, planes)], dtype=np.bool_)


def names_off(names: Sequence[str], planes: Sequence[str], enabled: Mask) -> tuple[str, ...]:
    """Name the devices that are not enabled, `NAME:plane` each."""
    own = labels(names, planes)
    return tuple(name for name, on in zip(own, enabled, strict=True) if not on)


def write_whole(path: Path, content: Settings) -> None:
    """Write a file of JSON: the whole file or none.

    Args:
        path: Where to; its directory is made if need be.
        content: What.

    Raises:
        OrbitFeedbackError: It cannot be written.
    """
    try:
        make_directory(path.parent)
        replace_file(path, f"{content.model_dump_json(indent=1)}\n".encode())
    except OSError as error:
        raise OrbitFeedbackError(f"{path} cannot be written: {error.strerror}") from error


def read_whole(path: Path, kind: type[S], advice: str) -> S:
    """Read a file of JSON.

    Args:
        path: Where it is.
        kind: What it must hold.
        advice: What to do if it does not.

    Raises:
        ConfigError: It cannot be read, is too long, or holds something else.
    """
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST + 1)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); {advice}") from None
    if len(data) > LARGEST:
        raise ConfigError(f"{path}: is longer than {LARGEST} bytes; {advice}")
    try:
        return kind.model_validate_json(data, strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise ConfigError(f"{path}: {where}: {first['msg']}; {advice}") from None
