"""Reference orbits on disk, by name."""

import re
from pathlib import Path

from orbitfb.app.commands.autosave import Reference, labels, read_whole, write_whole
from orbitfb.core.errors import ControlError
from orbitfb.core.signals import Channels, Vector

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,59}")


def reference_file(directory: Path, name: object) -> Path:
    """Give the file of a reference.

    Args:
        directory: Data directory.
        name: As asked for.

    Raises:
        ControlError: That is no name.
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise ControlError(
            f"{name!r} is no name of a reference: letters, digits, - _ and . , at most 60"
        )
    return directory / "references" / f"{name}.json"


def save_reference(path: Path, position: Vector, channels: Channels) -> None:
    """Save a reference.

    Args:
        path: Where to.
        position: Shape (n,) [m].
        channels: Of the loop.
    """
    bpms = labels(channels.bpms, channels.bpm_planes)
    write_whole(path, Reference(bpms=bpms, position=tuple(position.tolist())))


def load_reference(path: Path, channels: Channels) -> tuple[float, ...]:
    """Read a reference, shape (n,) [m].

    Args:
        path: Where it is.
        channels: Of the loop.

    Raises:
        ControlError: There is none, or it is of other BPMs.
        ConfigError: It is damaged.
    """
    if not path.exists():
        known = ", ".join(sorted(file.stem for file in path.parent.glob("*.json")))
        raise ControlError(f"no reference {path.stem!r} was saved; known: {known or 'none'}")
    loaded = read_whole(path, Reference, "save another one under this name")
    if loaded.bpms != labels(channels.bpms, channels.bpm_planes):
        raise ControlError(f"{path} is of other BPMs than the loop's")
    return loaded.position
