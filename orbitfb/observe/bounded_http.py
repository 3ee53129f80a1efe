"""A small read-only HTTP server that slow, broken or too many clients cannot stop."""

import contextlib
import socket
import socketserver
import threading
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, cast

import structlog

MOST_CONNECTIONS = 16
"""Connections at a time; one more puts out the oldest, so that the slow never block the quick."""

PATIENCE = 5.0
"""How long a client may be silent [s]."""

LARGEST_BODY = 65_536
"""What is read of the body of a refused request before it is answered [bytes]."""

TEXT = "text/plain; charset=utf-8"

Answer = tuple[HTTPStatus, str, bytes]
"""Status, content type and body."""


class BoundedServer(ThreadingHTTPServer):
    """A threading server that holds a bounded number of connections.

    Args:
        where: Address and port to listen on.
        answer: Returns the answer for a path and an `Accept` header.
    """

    daemon_threads = True
    request_queue_size = 64

    def __init__(
        self,
        where: tuple[str, int],
        answer: Callable[[str, str], Answer],
    ) -> None:
        self.answer = answer
        self._held: dict[Any, None] = {}  # in the order in which they came
        self._guard = threading.Lock()
        if ":" in where[0]:
            self.address_family = socket.AF_INET6
        super().__init__(where, _Handler)

    def server_bind(self) -> None:
        """Bind without the name look-up of the base class: it would leave this computer."""
        socketserver.TCPServer.server_bind(self)
        self.server_name, self.server_port = str(self.server_address[0]), self.server_address[1]

    def process_request(self, request: Any, client_address: Any) -> None:
        """Take a connection and put out the oldest when there are too many."""
        with self._guard:
            self._held[request] = None
            oldest = next(iter(self._held)) if len(self._held) > MOST_CONNECTIONS else None
            if oldest is not None:
                del self._held[oldest]
                _hang_up(oldest)
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """Forget a connection and close it."""
        with self._guard:
            self._held.pop(request, None)
        super().shutdown_request(request)

    def server_close(self) -> None:
        """Close the listening socket and put out who is still connected."""
        super().server_close()
        with self._guard:
            for request in self._held:
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
        try:
            answer = cast(BoundedServer, self.server).answer
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
