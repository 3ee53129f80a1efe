"""Locks of what one process alone may have; the kernel drops them however the process dies.

Locks and sockets live in the user's run-time directory, which is on a file system that knows
both; what they stand for may lie anywhere.
"""

import fcntl
import os
import stat
import tempfile
from hashlib import sha256
from pathlib import Path
from typing import Self

from orbitfb.core.errors import OwnershipError


def runtime_directory() -> Path:
    """Return this user's own directory for sockets and locks, made if need be.

    Raises:
        OwnershipError: It cannot be made, belongs to somebody else, or is open to others.
    """
    base = os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()
    path = Path(base) / f"orbitfb-{os.getuid()}"
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = path.lstat()
    except OSError as error:
        raise OwnershipError(
            f"{path}, for locks and the control socket, cannot be made ({error.strerror}); set "
            "XDG_RUNTIME_DIR to a directory of your own, or unset it"
        ) from None
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o077:
        raise OwnershipError(
            f"{path} must be a directory of user {os.getuid()} alone (mode 700); remove it"
        )
    return path


def own_file(key: str, suffix: str) -> Path:
    """Give the file of the run-time directory that stands for something.

    Args:
        key: Names it; of any length.
        suffix: Of the file.
    """
    return runtime_directory() / f"{sha256(key.encode()).hexdigest()[:16]}{suffix}"


class Lock:
    """An exclusive hold on something, for as long as this process lives.

    Args:
        key: What is held; equal keys exclude each other among the processes of this user.
        what: The same in words, for the message to whoever comes second.
        advice: What the second can do.

    Raises:
        OwnershipError: Another process holds it; the message says which.
    """

    def __init__(self, key: str, what: str, advice: str) -> None:
        path = own_file(key, ".lock")
        try:
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError as error:
            raise OwnershipError(
                f"{what} cannot be locked: {path}: {error.strerror}; repair that directory"
            ) from None
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.pread(self._descriptor, 32, 0).decode(errors="replace").strip()
            os.close(self._descriptor)
            raise OwnershipError(
                f"{what} is held by another orbitfb (process {holder or 'unknown'}); {advice}"
            ) from None
        os.ftruncate(self._descriptor, 0)
        os.pwrite(self._descriptor, str(os.getpid()).encode(), 0)

    def release(self) -> None:
        """Let go; the file stays, as removing it would let two hold it."""
        os.close(self._descriptor)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()
