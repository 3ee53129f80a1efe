"""Open a post-mortem, and read what it says of itself."""

from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py

from orbitfb.core.errors import RecordError
from orbitfb.history.segment import MARK
from orbitfb.postmortem.content import ABOUT, LONGEST_TEXT, SCHEMA_VERSION
from orbitfb.postmortem.datasets import Datasets


@contextmanager
def opened(path: Path) -> Generator[h5py.File, None, None]:
    """Open a post-mortem.

    Raises:
        RecordError: It is none, of another version, or damaged, now or while it is read.
    """
    if not path.is_file():
        raise RecordError(f"there is no file {path}; `orbitfb postmortem` lists what there is")
    try:
        with h5py.File(path, "r") as file:
            attribute = h5py.h5a.open(file.id, b"schema_version")
            plain = attribute.dtype.kind in "iu" and attribute.shape == ()
            found: Any = file.attrs["schema_version"] if plain else None
            if ABOUT not in file or found != SCHEMA_VERSION:
                if MARK in file:
                    raise RecordError(
                        f"{path} is a segment of the archive, no post-mortem; `orbitfb postmortem` "
                        "lists those that there are"
                    )
                raise RecordError(
                    f"{path} is no post-mortem of schema_version {SCHEMA_VERSION} (it has {found}, "
                    f"{'with' if ABOUT in file else 'without'} '{ABOUT}'); use the version of "
                    "orbitfb that wrote it"
                )
            yield file
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise RecordError(
            f"{path} is damaged, or no post-mortem ({error}); take it from a backup"
        ) from error
    except MemoryError as error:
        raise RecordError(f"{path} does not fit into the memory") from error


def read_about(path: Path) -> Mapping[str, Any]:
    """Read what a post-mortem says of itself, and nothing else of it.

    Raises:
        RecordError: It is no post-mortem, or damaged.
    """
    with opened(path) as file:
        return Datasets(file, path, LONGEST_TEXT).mapping(ABOUT, LONGEST_TEXT)


def text_of(about: Mapping[str, Any], key: str) -> str:
    """Give a text of what a file says of itself; nothing if it says something else."""
    value = about.get(key)
    return value if isinstance(value, str) else ""


def number_of(about: Mapping[str, Any], key: str) -> float:
    """Give a number of what a file says of itself; NaN if it says something else."""
    value = about.get(key)
    return float(value) if isinstance(value, int | float) and abs(value) < 1e15 else float("nan")
