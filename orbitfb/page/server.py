"""The page's server: uvicorn on a socket of ours, with bounds for slow, silent and many clients."""

import asyncio
import contextlib
import errno
import socket
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from orbitfb.control import ask
from orbitfb.core.errors import ControlError, OrbitFeedbackError, OwnershipError
from orbitfb.page.app import PATIENCE, page_app
from orbitfb.page.feed import Feed
from orbitfb.page.job import PageJob
from orbitfb.page.settings import WebSettings

SEND_BUFFER = 1 << 16
"""What the kernel keeps for a viewer that takes nothing [bytes]."""
MORE_CONNECTIONS = 32
"""Connections at a time besides those of viewers."""
_BACKLOG = 64


class PatientProtocol(H11Protocol):
    """A connection that ends when no request comes."""

    def connection_made(self, transport: Any) -> None:
        """Take a connection."""
        super().connection_made(transport)
        self.loop.call_later(PATIENCE, self._give_up)

    def _give_up(self) -> None:
        # one that has become a viewer's is in other hands
        if self.cycle is None and self in self.connections:
            self.transport.abort()


class QuietServer(uvicorn.Server):
    """A server that leaves the signals to whoever runs it."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
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
        http=PatientProtocol,
        ws="websockets-sansio",
        lifespan="off",
        log_config=None,
        log_level="critical",
        access_log=False,
        proxy_headers=False,
        server_header=False,
        limit_concurrency=job.web.viewers + MORE_CONNECTIONS,
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
