"""A small read-only HTTP server that slow, broken or too many clients cannot stop."""

import contextlib
import socket
import socketserver
import time
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, cast

import structlog

from orbitfb.core.connections import Connections
from orbitfb.core.host_names import HostNames

MOST_CONNECTIONS = 16
"""Connections at a time; one more puts out the oldest, so that the slow never block the quick."""

BREATH = 0.1
"""Wait before the next try to take a connection while there are no file descriptors [s]."""

PATIENCE = 5.0
"""How long a client may be silent [s]."""

LARGEST_BODY = 65_536
"""What is read of the body of a refused request before it is answered [bytes]."""

TEXT = "text/plain; charset=utf-8"

STRANGER = b"this name is not known here; ask by address, or put the name into observe.names\n"
"""Answer to who asks for a name that is not ours: a page of another site, perhaps."""

Answer = tuple[HTTPStatus, str, bytes]
"""Status, content type and body."""


class BoundedServer(ThreadingHTTPServer):
    """A threading server that holds a bounded number of connections.

    Args:
        where: Address and port to listen on.
        answer: Returns the answer for a path and an `Accept` header.
        names: By which it may be asked.
    """

    daemon_threads = True
    timeout = 0.1
    """Longest that `handle_request` waits for a request [s]."""
    request_queue_size = 64

    def __init__(
        self,
        where: tuple[str, int],
        answer: Callable[[str, str], Answer],
        names: HostNames,
    ) -> None:
        self.answer, self.names = answer, names
        self._held: Connections[Any] = Connections(MOST_CONNECTIONS)
        if ":" in where[0]:
            self.address_family = socket.AF_INET6
        super().__init__(where, _Handler)

    def server_bind(self) -> None:
        """Bind without the name look-up of the base class: it would leave this computer."""
        socketserver.TCPServer.server_bind(self)
        self.server_name, self.server_port = str(self.server_address[0]), self.server_address[1]

    def get_request(self) -> tuple[Any, Any]:
        """Take a connection; without descriptors for it, wait a little instead of spinning."""
        try:
            return super().get_request()
        except OSError:
            time.sleep(BREATH)
            raise

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection and put out an older one when there are too many."""
        leaving = self._held.add(request, str(client_address[0]))
        if leaving is not None:
            _hang_up(leaving)
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """Forget a connection and close it."""
        self._held.remove(request)
        super().shutdown_request(request)

    def server_close(self) -> None:
        """Close the listening socket and put out who is still connected."""
        super().server_close()
        for request in self._held.all():
            _hang_up(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Tell the log, not the terminal."""
        structlog.stdlib.get_logger("orbitfb.observe").warning(
            "http_request_failed", client=str(client_address[0]), exc_info=True
        )


def _hang_up(connection: socket.socket) -> None:
    """End a connection from outside; its thread then sees the end and closes it."""
    with contextlib.suppress(OSError):  # it has gone by itself
        connection.shutdown(socket.SHUT_RDWR)


class _Handler(BaseHTTPRequestHandler):
    """Answer one request per connection; nothing of the request comes back in an answer."""

    server_version = "orbitfb"
    sys_version = ""
    default_request_version = "HTTP/1.0"  # of 0.9, whose answers have no status line
    timeout = PATIENCE

    def handle(self) -> None:
        """Answer; a client that leaves in the middle is no error of ours."""
        with contextlib.suppress(ConnectionError, TimeoutError):
            super().handle()

    def finish(self) -> None:
        """Flush what is left to say, if there is still somebody to hear it."""
        with contextlib.suppress(ConnectionError, TimeoutError):
            super().finish()

    def do_GET(self) -> None:  # name given by the base class
        """Answer GET and HEAD."""
        path = self.path.partition("?")[0].partition("#")[0]
        server = cast(BoundedServer, self.server)
        if not all(server.names.knows(host) for host in self.headers.get_all("Host", ())):
            self._send(HTTPStatus.MISDIRECTED_REQUEST, TEXT, STRANGER)
            return
        try:
            answer = server.answer
            status, content_type, body = answer(path, self.headers.get("Accept", ""))
        except Exception:  # outermost guard of the connection's thread: the log gets it
            structlog.stdlib.get_logger("orbitfb.observe").exception("http_answer_failed")
            status, content_type, body = (
                HTTPStatus.INTERNAL_SERVER_ERROR,
                TEXT,
                b"failed; the log says why\n",
            )
        self._send(status, content_type, body)

    do_HEAD = do_GET  # noqa: N815  # name given by the base class

    def _refuse(self) -> None:
        with contextlib.suppress(ValueError):  # a length that is no number: nothing to read
            self.rfile.read(max(0, min(int(self.headers["Content-Length"] or 0), LARGEST_BODY)))
        self._send(HTTPStatus.METHOD_NOT_ALLOWED, TEXT, b"read-only: GET or HEAD\n")

    do_POST = do_PUT = do_PATCH = do_DELETE = do_OPTIONS = do_TRACE = do_CONNECT = _refuse  # noqa: N815

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Refuse a malformed request without repeating any of it."""
        status = HTTPStatus(code)
        self._send(status, TEXT, f"{status.phrase.lower()}\n".encode())

    def _send(self, status: HTTPStatus, content_type: str, body: bytes) -> None:
        self.close_connection = True
        self.send_response(status)
        self.send_header("Content-Type", content_type)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        if status is HTTPStatus.METHOD_NOT_ALLOWED:
            self.send_header("Allow", "GET, HEAD")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing: a scrape every few seconds is no news."""
