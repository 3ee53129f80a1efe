"""How one command line speaks to a running service, and how two services keep out of each other.

A service owns its data directory and its ring by advisory file locks, which the kernel drops
when the process dies however it dies. It listens on a Unix socket that only its user can open:
one JSON object per line in, one out. Sockets and locks live in the user's run-time directory,
which is on a file system that knows both; a data directory may lie anywhere.
"""

import contextlib
import fcntl
import hashlib
import json
import os
import pwd
import socket
import stat
import struct
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Self

from orbitfb.core.errors import ControlError, OrbitFeedbackError, OwnershipError

MESSAGE_LIMIT = 1 << 20
"""Longest message that either side reads [bytes]."""

_LONGEST_SOCKET_PATH = 100

BACKLOG = 128
"""Connections that may wait; beyond it the kernel turns a command line away at once."""

Handler = Callable[[Mapping[str, Any]], Mapping[str, Any]]


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
        try:
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError as error:
            raise OwnershipError(
                f"{what} cannot be locked: {path}: {error.strerror}; mend that directory"
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


def _socket_path(data_directory: Path) -> Path:
    return runtime_directory() / f"{_digest(str(data_directory.resolve()))}.sock"


@contextlib.contextmanager
def _address(path: Path) -> Iterator[str]:
    """Give a socket's path as the kernel takes it, through an open directory if it is long."""
    if len(os.fsencode(path)) <= _LONGEST_SOCKET_PATH:
        yield str(path)
        return
    directory = os.open(path.parent, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield f"/proc/self/fd/{directory}/{path.name}"
    finally:
        os.close(directory)


class ControlServer:
    """Answers commands of this user's command lines, in a thread of its own.

    Args:
        data_directory: The service's data directory: its name to the outside.
        handler: Gets each request, returns the answer, made of what JSON knows; what it raises
            is told to the one who asked.

    Raises:
        OwnershipError: The socket cannot be made.
    """

    def __init__(self, data_directory: Path, handler: Handler) -> None:
        self._path = _socket_path(data_directory)
        self._handler = handler
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._path.unlink(missing_ok=True)
            with _address(self._path) as address:
                self._listener.bind(address)
            self._path.chmod(0o600)
            self._listener.listen(BACKLOG)
        except OSError as error:
            self._listener.close()
            raise OwnershipError(
                f"the control socket {self._path} cannot be made ({error.strerror or error}); "
                "mend that directory, or set XDG_RUNTIME_DIR to another"
            ) from None
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
            try:
                request = {**_receive(connection), "peer": _peer(connection)}
                answer = _encode({"ok": True, **self._handler(request)})
            except OrbitFeedbackError as error:
                answer = _encode({"ok": False, "error": str(error)})
            except Exception as error:  # the outermost guard of this thread: the asker is told
                problem = f"the service failed at this: {error!r}"
                answer = _encode({"ok": False, "error": problem})
            connection.sendall(answer)

    def close(self) -> None:
        """Stop listening."""
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join(timeout=1.0)
        with contextlib.suppress(FileNotFoundError):
            self._path.unlink()


def _peer(connection: socket.socket) -> dict[str, Any]:
    """Say who is at the other end, as the kernel knows it: `user` and `process`."""
    credentials = struct.Struct("3i")
    data = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, credentials.size)
    process, user, _ = credentials.unpack(data)
    try:
        name = pwd.getpwuid(user).pw_name
    except KeyError:
        name = str(user)
    return {"user": name, "process": process}


def is_running(data_directory: Path) -> bool:
    """Say whether a service answers for a data directory."""
    with (
        socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection,
        _address(_socket_path(data_directory)) as address,
    ):
        return connection.connect_ex(address) == 0


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
            with _address(path) as address:
                connection.connect(address)
        except OSError:
            raise ControlError(
                f"no service of this user runs on {data_directory.resolve()}; start one with "
                f"`orbitfb run`, name its directory with --data, or give this shell the service's "
                f"XDG_RUNTIME_DIR (here its socket would be in {path.parent})"
            ) from None
        try:
            connection.sendall(_encode(request))
            answer = dict(_receive(connection))
        except OSError as error:
            raise ControlError(f"the service did not answer within {timeout} s: {error}") from None
    if not answer.pop("ok", False):
        raise ControlError(str(answer.get("error", "the service refused without a reason")))
    return answer


def _encode(message: Mapping[str, Any]) -> bytes:
    return json.dumps(message, allow_nan=False).encode() + b"\n"


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
    except (ValueError, RecursionError):
        raise ControlError("the message is not JSON") from None
    if not isinstance(message, dict):
        raise ControlError("the message is not a JSON object")
    return message
