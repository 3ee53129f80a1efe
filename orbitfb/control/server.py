"""How a running service listens to command lines; `client` is the other end."""

import contextlib
import errno
import pwd
import socket
import struct
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import structlog

from orbitfb.control.client import address_of, encode, receive, socket_path
from orbitfb.core.connections import Connections
from orbitfb.core.errors import OrbitFeedbackError, OwnershipError

BACKLOG = 128
"""Connections that may wait; beyond it the kernel turns a command line away at once."""

MOST_CONVERSATIONS = 32
"""Conversations at a time: the panel's eight threads, the page's one, and three times as many
command lines. One more puts out the oldest that has not asked anything yet."""

SHORT = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM})
"""What the kernel says while the computer is short of something: it passes."""

_BREATH = 0.1
"""Wait before the next try to take a connection while the computer is short of something [s]."""

Handler = Callable[[Mapping[str, Any]], Mapping[str, Any]]

_log = structlog.stdlib.get_logger("orbitfb.control.server")


class ControlServer:
    """Answers commands of this user's command lines, in a thread of its own.

    The conversations are bounded, so that those who only connect cannot use up the descriptors
    of the loop. Where they are used up by others, the server waits until there are some again.

    Args:
        data_directory: The service's data directory: its name to the outside.
        handler: Gets each request, returns the answer, made of what JSON knows; what it raises
            is told to the one who asked.

    Raises:
        OwnershipError: The socket cannot be made.
    """

    def __init__(self, data_directory: Path, handler: Handler) -> None:
        self._path = socket_path(data_directory)
        self._handler = handler
        self._problem = ""
        self._closed = threading.Event()
        self._conversations: Connections[socket.socket] = Connections(MOST_CONVERSATIONS)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._path.unlink(missing_ok=True)
            with address_of(self._path) as address:
                self._listener.bind(address)
            self._path.chmod(0o600)
            self._listener.listen(BACKLOG)
        except OSError as error:
            self._listener.close()
            raise OwnershipError(
                f"the control socket {self._path} cannot be made ({error.strerror or error}); "
                "repair that directory, or set XDG_RUNTIME_DIR to another"
            ) from None
        self._thread = threading.Thread(target=self._serve, name="control", daemon=True)
        self._thread.start()

    @property
    def problem(self) -> str:
        """Why it answers nobody now; empty while it answers."""
        return self._problem

    def _serve(self) -> None:
        while not self._closed.is_set():
            try:
                connection, _ = self._listener.accept()
            except OSError as error:
                if error.errno in SHORT:
                    self._say(f"the control socket answers nobody: {error.strerror}")
                self._closed.wait(_BREATH)  # or whoever wanted to speak has gone already
                continue
            self._say("")
            self._take(connection)

    def _say(self, problem: str) -> None:
        """Tell when it stops answering and when it answers again, once each."""
        if problem == self._problem:
            return
        before, self._problem = self._problem, problem
        if not before:
            _log.error("control_socket_starved", problem=problem)
        elif not problem:
            _log.warning("control_socket_answers_again", problem=before)

    def _take(self, connection: socket.socket) -> None:
        """Begin a conversation; one that has asked nothing gives way when there are too many."""
        if (leaving := self._conversations.add(connection)) is connection:
            self._turn_away(connection)
            return
        if leaving is not None:
            with contextlib.suppress(OSError):  # it has gone by itself
                leaving.shutdown(socket.SHUT_RDWR)
        thread = threading.Thread(
            target=self._converse, args=(connection,), name="control-client", daemon=True
        )
        try:
            thread.start()
        except RuntimeError:  # the computer has no thread for it
            self._conversations.remove(connection)
            self._turn_away(connection)

    def _turn_away(self, connection: socket.socket) -> None:
        problem = "the service is busy with other commands; ask again in some seconds"
        with connection, contextlib.suppress(OSError):
            connection.setblocking(False)
            connection.sendall(encode({"ok": False, "error": problem}))

    def _converse(self, connection: socket.socket) -> None:
        with connection, contextlib.suppress(OSError):
            connection.settimeout(30.0)
            try:
                request = {**receive(connection), "peer": _peer(connection)}
                self._conversations.keep(connection)
                answer = encode({"ok": True, **self._handler(request)})
            except OrbitFeedbackError as error:
                answer = encode({"ok": False, "error": str(error)})
            except Exception as error:  # the outermost guard of this thread: the asker is told
                problem = f"the service failed at this: {error!r}"
                answer = encode({"ok": False, "error": problem})
            try:
                connection.sendall(answer)
            finally:
                self._conversations.remove(connection)

    def close(self) -> None:
        """Stop listening."""
        self._closed.set()
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
