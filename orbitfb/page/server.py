"""The page's server: uvicorn on a socket of ours, with bounds for slow, silent and many clients."""

import asyncio
import contextlib
import errno
import socket
from collections.abc import Callable, Generator
from functools import partial
from typing import Any, cast

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from orbitfb.control.client import ask
from orbitfb.core.connections import Connections
from orbitfb.core.errors import ControlError, OrbitFeedbackError, OwnershipError
from orbitfb.page.app import PATIENCE, page_app
from orbitfb.page.feed import Feed
from orbitfb.page.job import PageJob
from orbitfb.page.settings import WebSettings

SEND_BUFFER = 1 << 16
"""What the kernel keeps for a viewer that takes nothing [bytes]."""
MORE_CONNECTIONS = 32
"""Connections at a time that are no viewers', and viewers' that are being turned away."""
_BACKLOG = 64


class PatientProtocol(H11Protocol):
    """A connection that ends when no request comes, or when it has to give way to another.

    Args:
        room: Counts those that are no viewers' yet.
    """

    def __init__(self, room: Connections[Any], **given: Any) -> None:
        super().__init__(**given)
        self._room = room

    def connection_made(self, transport: Any) -> None:
        """Take a connection."""
        super().connection_made(transport)
        self.loop.call_later(PATIENCE, self._give_up)
        _make_room(self._room, transport)

    def connection_lost(self, exc: Exception | None) -> None:
        """Count it out."""
        self._room.remove(self.transport)
        super().connection_lost(exc)

    def handle_websocket_upgrade(self, event: Any) -> None:
        """Count it out: it goes on as a viewer's."""
        self._room.remove(self.transport)
        super().handle_websocket_upgrade(event)

    def _give_up(self) -> None:
        # one that has become a viewer's is in other hands
        if self.cycle is None and self in self.connections:
            self.transport.abort()


class ViewerProtocol(WebSocketsSansIOProtocol):
    """A viewer's connection, or one that the feed turns away and that does not go.

    Args:
        room: Counts them.
    """

    def __init__(self, room: Connections[Any], **given: Any) -> None:
        super().__init__(**given)
        self._room = room

    def connection_made(self, transport: Any) -> None:
        """Take a connection."""
        super().connection_made(transport)
        _make_room(self._room, transport)

    def connection_lost(self, exc: Exception | None) -> None:
        """Count it out."""
        self._room.remove(self.transport)
        super().connection_lost(exc)


def _make_room(room: Connections[Any], transport: Any) -> None:
    """Count a connection in; when there are too many, the oldest of who has most gives way."""
    peer = transport.get_extra_info("peername")
    leaving = room.add(transport, peer[0] if peer else "")
    if leaving is not None:
        leaving.abort()


class QuietServer(uvicorn.Server):
    """A server that leaves the signals to whoever runs it."""

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None, None, None]:
        """Capture none."""
        yield


async def serve(job: PageJob, announce: Callable[[int, int], None], stop: asyncio.Event) -> None:
    """Serve the page until told to stop.

    Args:
        job: What to show.
        announce: Gets the port and the number of BPMs once browsers can connect.
        stop: Ends it when set.

    Raises:
        OwnershipError: Somebody else has the port, or the address is not of this computer.
    """
    listener = listen(job.web)
    feed = Feed(job, partial(_ask_service, job))
    server = QuietServer(_configuration(job, feed))
    serving = asyncio.create_task(server.serve(sockets=[listener]))
    tasks: list[asyncio.Task[Any]] = [serving, asyncio.create_task(feed.keep_asking())]
    try:
        while not server.started and not serving.done():
            await asyncio.sleep(0.01)
        announce(listener.getsockname()[1], len(job.layout.bpms))
        tasks.append(asyncio.create_task(stop.wait()))
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in tasks:
            if task.done() and not task.cancelled() and (failure := task.exception()):
                raise failure
    finally:
        server.should_exit = True
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(serving, 3.0)
        for task in tasks:
            task.cancel()
        feed.close()
        listener.close()


def listen(settings: WebSettings) -> socket.socket:
    """Listen where the settings say.

    Raises:
        OwnershipError: Somebody else has the port, or the address is not of this computer.
    """
    where = (settings.host, settings.port)
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        # what is accepted has both from here; the kernel drops who does not take what it is sent
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        patience = round(1e3 * PATIENCE)
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, patience)
        listener.bind(where)
        listener.listen(_BACKLOG)
    except OSError as error:
        listener.close()
        if error.errno == errno.EADDRINUSE:
            problem = (
                f"{where[0]} port {where[1]} is in use, by the page of another service perhaps"
            )
        else:
            problem = f"{where[0]} port {where[1]} cannot be listened on ({error.strerror})"
        raise OwnershipError(
            f"{problem}; set web.host and web.port (0 takes any free port)"
        ) from error
    return listener


def _configuration(job: PageJob, feed: Feed) -> uvicorn.Config:
    return uvicorn.Config(
        page_app(job, feed),
        loop="asyncio",
        http=cast(Any, partial(PatientProtocol, Connections(MORE_CONNECTIONS))),
        ws=cast(Any, partial(ViewerProtocol, Connections(job.web.viewers + MORE_CONNECTIONS))),
        lifespan="off",
        log_config=None,
        log_level="critical",
        access_log=False,
        proxy_headers=False,
        server_header=False,
        timeout_keep_alive=5,
        timeout_graceful_shutdown=1,
        h11_max_incomplete_event_size=16_384,
        ws_max_size=1024,
        ws_ping_interval=PATIENCE / 2,
        ws_ping_timeout=PATIENCE,
        ws_per_message_deflate=False,
    )


def _ask_service(job: PageJob, request: dict[str, Any], timeout: float) -> dict[str, Any]:
    try:
        return ask(job.data_directory, request, timeout)
    except ControlError:
        raise
    except OrbitFeedbackError as error:
        raise ControlError(str(error)) from None
