"""Files that are there whole or not at all: bounded reading, durable writing, one writer."""

import fcntl
import json
import shutil
import time
import uuid
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

from orbitfb.core.errors import StoreError
from orbitfb.core.files.bounded import take
from orbitfb.core.files.state import (
    OWN,
    make_directory,
    open_to_append,
    sync_directory,
    write_through,
)
from orbitfb.core.files.state import replace_file as put

SCHEMA_VERSION = 2
"""Version of the files of the store that is written. 2: cards tell the training."""

READABLE = (1, 2)
"""Versions that are read; another one is refused."""

_UNFINISHED = ".unfinished-"
_LOCK_WAIT = 10.0


def read_bounded(path: Path, largest: int, advice: str) -> bytes:
    """Read a file, but never more than is expected.

    Args:
        path: The file.
        largest: Largest size that is read [bytes].
        advice: What to do when it is damaged.

    Raises:
        StoreError: It is absent, unreadable or larger.
    """
    try:
        with path.open("rb") as file:
            content = take(file, largest + 1)
    except OSError as error:
        raise StoreError(f"{path} cannot be read ({error.strerror}); {advice}") from error
    if len(content) > largest:
        raise StoreError(f"{path} is larger than the {largest} bytes expected; {advice}")
    return content


def read_json(path: Path, largest: int, advice: str) -> dict[str, Any]:
    """Read a small JSON object of this version.

    Args:
        path: The file.
        largest: Largest size that is read [bytes].
        advice: What to do when it is damaged.

    Raises:
        StoreError: It is absent, too large, not JSON, or of another version.
    """
    text = read_bounded(path, largest, advice)
    try:
        content: object = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise StoreError(f"{path} is not readable JSON ({error}); {advice}") from error
    if not isinstance(content, dict):
        raise StoreError(f"{path} holds no JSON object; {advice}")
    card = cast("dict[str, Any]", content)
    version = card.get("schema_version")
    if version not in READABLE:
        raise StoreError(
            f"{path} has schema_version {version!r}, this program reads "
            f"{' and '.join(map(str, READABLE))}; use the version of orbitfb that wrote it, or "
            "refit"
        )
    return card


def publish_directory(final: Path, files: Mapping[str, bytes]) -> None:
    """Let a directory appear with all its files, on disk before it has its name.

    Raises:
        OSError: It cannot be written; nothing is left behind.
    """
    unfinished = final.parent / f"{_UNFINISHED}{uuid.uuid4().hex}"
    try:
        make_directory(unfinished)
        for name, content in files.items():
            write_through(unfinished / name, content)
        sync_directory(unfinished)
        unfinished.rename(final)
    except OSError:
        shutil.rmtree(unfinished, ignore_errors=True)
        raise
    sync_directory(final.parent)


def remove_directory(path: Path) -> None:
    """Let a directory disappear at once, then free its space.

    Raises:
        OSError: It cannot be removed.
    """
    leaving = path.parent / f"{_UNFINISHED}{uuid.uuid4().hex}"
    path.rename(leaving)
    shutil.rmtree(leaving)


def replace_file(path: Path, content: bytes, mode: int = OWN) -> None:
    """Put new content in the place of a file: readers see the old or the new.

    Args:
        path: The file.
        content: Of the file.
        mode: Who may do what with it.

    Raises:
        OSError: It cannot be written; the old content stays.
    """
    put(path, content, mode, path.parent / f"{_UNFINISHED}{uuid.uuid4().hex}")


@contextmanager
def sole_writer(directory: Path) -> Generator[None]:
    """Be the only writer among threads and processes; sweep away what a killed one left.

    The lock belongs to an open file, so the kernel frees it when its holder dies.

    Raises:
        StoreError: The directory cannot be used, or another writer does not finish.
    """
    try:
        make_directory(directory)
        lock = open_to_append(directory / ".lock")
    except OSError as error:
        raise StoreError(
            f"the policy store {directory} cannot be used ({error.strerror}); name another "
            "directory or repair its permissions"
        ) from error
    with lock:
        _take(lock.fileno(), directory)
        for left in directory.glob(f"{_UNFINISHED}*"):
            # Only a holder of the lock makes these, so whoever made this one is dead.
            if left.is_dir():
                shutil.rmtree(left, ignore_errors=True)
            else:
                left.unlink(missing_ok=True)
        yield


def _take(descriptor: int, directory: Path) -> None:
    deadline = time.monotonic() + _LOCK_WAIT
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            if time.monotonic() > deadline:
                raise StoreError(
                    f"another process has been writing to {directory} for {_LOCK_WAIT:.0f} s; "
                    "look for a stopped orbitfb and try again"
                ) from error
            time.sleep(0.02)
        else:
            return
