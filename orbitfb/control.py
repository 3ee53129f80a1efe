"""How one command line speaks to a running service, and how two services keep out of each other.

A service owns its data directory and its ring by advisory file locks, which the kernel drops
when the process dies however it dies. It listens on a Unix socket that only its user can open:
one JSON object per line in, one out. Sockets and locks live in the user's run-time directory,
because the path of a socket may have no more than about 100 characters.
"""

import contextlib
import fcntl
import hashlib
import json
import os
import socket
import stat
import tempfile
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Self

from orbitfb.core.errors import ControlError, OrbitFeedbackError, OwnershipError

MESSAGE_LIMIT = 1 << 20
"""Longest message that either side reads [bytes]."""

Handler = Callable[[Mapping[str, Any]], Mapping[str, Any]]


def runtime_directory() -> Path:
    """Return this user's own directory for sockets and locks, made if need be.

    Raises:
        OwnershipError: It exists and belongs to somebody else or is open to others.
    """
    base = os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()
    path = Path(base) / f"orbitfb-{os.getuid()}"
    path.mkdir(mode=0o700, parents=True, exist_ok=True)
    status = path.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o077:
        raise OwnershipError(
            f"{path} must be a directory of user {os.getuid()} alone (mode 700); remove it"
        )
    return path


def _digest(what: str) -> str:
    return hashlib.sha256(what.encode()).hexdigest()[:16]


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
        path = runtime_directory() / f"{_digest(key)}.lock"
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
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


def _socket_path(data_directory: Path) -> Path:
    return runtime_directory() / f"{_digest(str(data_directory.resolve()))}.sock"


class ControlServer:
    """Answers commands of this user's command lines, in a thread of its own.

    Args:
        data_directory: The service's data directory: its name to the outside.
        handler: Gets each request, returns the answer; an `OrbitFeedbackError` that it raises
            is told to the one who asked.
    """

    def __init__(self, data_directory: Path, handler: Handler) -> None:
        self._path = _socket_path(data_directory)
        self._handler = handler
        with contextlib.suppress(FileNotFoundError):
            self._path.unlink()
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.bind(str(self._path))
        self._path.chmod(0o600)
        self._listener.listen(8)
        self._thread = threading.Thread(target=self._serve, name="control", daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            threading.Thread(
                target=self._converse, args=(connection,), name="control-client", daemon=True
            ).start()

    def _converse(self, connection: socket.socket) -> None:
        with connection, contextlib.suppress(OSError):
            connection.settimeout(30.0)
            answer: Mapping[str, Any]
            try:
                answer = {"ok": True, **self._handler(_receive(connection))}
            except OrbitFeedbackError as error:
                answer = {"ok": False, "error": str(error)}
            _send(connection, answer)

    def close(self) -> None:
        """Stop listening."""
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join(timeout=1.0)
        with contextlib.suppress(FileNotFoundError):
            self._path.unlink()


def is_running(data_directory: Path) -> bool:
    """Say whether a service answers for a data directory."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        return connection.connect_ex(str(_socket_path(data_directory))) == 0


def ask(data_directory: Path, request: Mapping[str, Any], timeout: float = 30.0) -> dict[str, Any]:
    """Send one request to the service that owns a data directory and wait for the answer.

    Args:
        data_directory: The service's data directory.
        request: A JSON object, `{"command": "status"}`.
        timeout: How long to wait for the answer [s].

    Raises:
        ControlError: No service runs there, it does not answer, or it refuses.
    """
    path = _socket_path(data_directory)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(timeout)
        try:
            connection.connect(str(path))
        except OSError:
            raise ControlError(
                f"no service runs on {data_directory.resolve()}; start one with `orbitfb run`, or "
                "name its directory with --data"
            ) from None
        try:
            _send(connection, request)
            answer = dict(_receive(connection))
        except OSError as error:
            raise ControlError(f"the service did not answer within {timeout} s: {error}") from None
    if not answer.pop("ok", False):
        raise ControlError(str(answer.get("error", "the service refused without a reason")))
    return answer


def _send(connection: socket.socket, message: Mapping[str, Any]) -> None:
    connection.sendall(json.dumps(message, allow_nan=False).encode() + b"\n")


def _receive(connection: socket.socket) -> Mapping[str, Any]:
    data = b""
    while not data.endswith(b"\n"):
        chunk = connection.recv(65536)
        if not chunk:
            raise ControlError("the other side hung up in the middle of a message")
        data += chunk
        if len(data) > MESSAGE_LIMIT:
            raise ControlError(f"a message of more than {MESSAGE_LIMIT} bytes was refused")
    try:
        message = json.loads(data)
    except ValueError:
        raise ControlError("the message is not JSON") from None
    if not isinstance(message, dict):
        raise ControlError("the message is not a JSON object")
    return message
