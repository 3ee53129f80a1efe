"""Files of the data directory: of this user alone, never through a link, whole or not there.

Whoever can write to the directory could put a link where the program is about to write, and have
it overwrite a file elsewhere. What the program makes here is made new or not at all.
"""

import errno
import os
from pathlib import Path
from typing import IO

OWN = 0o600
"""Mode of a file that this user alone reads and writes, whatever the umask."""
AS_USUAL = 0o666
"""Mode of a file that the user wanted elsewhere: the umask decides who reads it."""
NEW = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
"""Flags to open a file that must be new."""
_MORE = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_CLOEXEC


def make_directory(path: Path) -> None:
    """Make a directory, and those above it that are missing, for this user alone (mode 700).

    Args:
        path: The directory; one that is there stays as it is.

    Raises:
        OSError: It cannot be made, or there is a file of that name.
    """
    for each in reversed([each for each in path.parents if not each.exists()]):
        each.mkdir(mode=0o700, exist_ok=True)
    path.mkdir(mode=0o700, exist_ok=True)


def create_descriptor(path: Path, mode: int = OWN) -> int:
    """Make a new file; what has its name, or waits there as a link, is removed before.

    Args:
        path: The file.
        mode: Who may do what with it.

    Returns:
        Its descriptor, to read and to write.

    Raises:
        OSError: It cannot be made.
    """
    path.unlink(missing_ok=True)
    return os.open(path, NEW, mode)


def create(path: Path, mode: int = OWN) -> IO[bytes]:
    """Make a new file and open it to be written; see `create_descriptor`."""
    return os.fdopen(create_descriptor(path, mode), "wb")


def open_to_append(path: Path) -> IO[str]:
    """Open a file of text to write at its end; it is made if it is not there.

    Raises:
        OSError: It cannot be opened, or is a link.
    """
    try:
        descriptor = os.open(path, _MORE, OWN)
    except OSError as error:
        if error.errno != errno.ELOOP:
            raise
        raise OSError(errno.ELOOP, "it is a link, and links are not followed", str(path)) from None
    return os.fdopen(descriptor, "a", encoding="utf-8")


def write_through(path: Path, content: bytes | memoryview, mode: int = OWN) -> None:
    """Write a new file to the disk.

    Args:
        path: The file.
        content: Of the file.
        mode: Who may do what with it.

    Raises:
        OSError: It cannot be written.
    """
    with create(path, mode) as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def sync_directory(path: Path) -> None:
    """Have the names within a directory on the disk.

    Raises:
        OSError: The disk refuses.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def replace_file(
    path: Path, content: bytes | memoryview, mode: int = OWN, part: Path | None = None
) -> None:
    """Put new content in the place of a file: readers see the old or the new.

    Args:
        path: The file.
        content: Of the file.
        mode: Who may do what with it.
        part: Where it is written before it has its name, in the same directory; None:
            `.NAME.part`.

    Raises:
        OSError: It cannot be written; the old content stays.
    """
    part = part or path.with_name(f".{path.name}.part")
    try:
        write_through(part, content, mode)
        part.replace(path)
    except OSError:
        part.unlink(missing_ok=True)
        raise
    sync_directory(path.parent)
