"""How one command line speaks to a running service, from the side of the one who asks.

The service listens on a Unix socket that only its user can open: one JSON object per line in, one
out. The socket lives in the user's run-time directory, as a data directory may lie where there are
none. A command starts in a fifth of a second: nothing is imported here that it does not need.
"""

import contextlib
import json
import os
import socket
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import Any

from orbitfb.core.errors import ControlError
from orbitfb.core.files.ownership import own_file

MESSAGE_LIMIT = 1 << 20
"""Longest message that either side reads [bytes]."""

_LONGEST_SOCKET_PATH = 100


def is_running(data_directory: Path) -> bool:
    """Say whether a service answers for a data directory."""
    with (
        socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection,
        address_of(socket_path(data_directory)) as address,
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
    path = socket_path(data_directory)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(timeout)
        try:
            with address_of(path) as address:
                connection.connect(address)
        except OSError:
            raise ControlError(
                f"no service of this user runs on {data_directory.resolve()}; start one with "
                f"`orbitfb run`, name its directory with --data, or give this shell the service's "
                f"XDG_RUNTIME_DIR (here its socket would be in {path.parent})"
            ) from None
        try:
            connection.sendall(encode(request))
            answer = dict(receive(connection))
        except OSError as error:
            raise ControlError(f"the service did not answer within {timeout} s: {error}") from None
    if not answer.pop("ok", False):
        raise ControlError(str(answer.get("error", "the service refused without a reason")))
    return answer


def socket_path(data_directory: Path) -> Path:
    """Give the socket of the service that owns a data directory."""
    return own_file(str(data_directory.resolve()), ".sock")


@contextlib.contextmanager
def address_of(path: Path) -> Generator[str, None, None]:
    """Give a socket's path as the kernel takes it, through an open directory if it is long."""
    if len(os.fsencode(path)) <= _LONGEST_SOCKET_PATH:
        yield str(path)
        return
    directory = os.open(path.parent, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield f"/proc/self/fd/{directory}/{path.name}"
    finally:
        os.close(directory)


def encode(message: Mapping[str, Any]) -> bytes:
    """Make a message a line."""
    return json.dumps(message, allow_nan=False).encode() + b"\n"


def receive(connection: socket.socket) -> Mapping[str, Any]:
    """Wait for a message.

    Raises:
        ControlError: It ends too early, is too long, or is no JSON object.
    """
    data = b""
    while not data.endswith(b"\n"):
        chunk = connection.recv(65536)
        if not chunk:
            raise ControlError("the connection closed in the middle of a message")
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
