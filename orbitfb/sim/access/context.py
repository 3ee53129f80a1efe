"""caproto's server on sockets that were claimed before, without beacons."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from typing import Any

from caproto.asyncio.server import Context

from orbitfb.sim.access.listening import Sockets
from orbitfb.sim.access.transport import Datagrams, Stream

_AGAIN = 0.05
"""How long a task may take to end before it is cancelled again [s]."""


async def end_tasks(tasks: Sequence[asyncio.Task[Any]]) -> None:
    """Cancel tasks until all of them have ended.

    Once is not enough: caproto waits for what it is to send by `asyncio.wait_for`, which in Python
    3.11 forgets that it was cancelled if there is something to send at that moment.

    Args:
        tasks: What is to end.
    """
    while left := [task for task in tasks if not task.done()]:
        for task in left:
            task.cancel()
        with suppress(asyncio.CancelledError):  # whoever cancels this wants the same
            await asyncio.wait(left, timeout=_AGAIN)


class ClaimedContext(Context):
    """A server that speaks on its own two sockets and nowhere else.

    On loopback there is no repeater that beacons would reach, elsewhere nobody asked for them.

    Args:
        pvdb: The PVs by name.
        sockets: Where it listens.
    """

    def __init__(self, pvdb: dict[str, Any], sockets: Sockets) -> None:
        super().__init__(pvdb, [sockets.interface])
        self.port = sockets.port
        self._claimed = sockets

    async def run(
        self,
        *,
        log_pv_names: bool = False,
        startup_hook: Callable[[Any], Awaitable[None]] | None = None,
    ) -> None:
        """Serve until cancelled.

        Args:
            log_pv_names: Has no effect: there are hundreds.
            startup_hook: Runs once clients can connect.
        """
        interface = self._claimed.interface
        self.broadcaster.server_addresses.append((interface, self.port))
        _, searches = await asyncio.get_running_loop().create_datagram_endpoint(
            lambda: Datagrams(interface, self.broadcaster_datagram_queue), sock=self._claimed.udp
        )
        self.udp_socks[interface] = searches
        hooks = [*([startup_hook] if startup_hook else []), *self.startup_methods.values()]
        tasks = [
            asyncio.ensure_future(part)
            for part in (
                self.server_accept_loop(self._claimed.tcp),
                self.broadcaster_receive_loop(),
                self.broadcaster_queue_loop(),
                self.subscription_queue_loop(),
                *(hook(self.async_layer) for hook in hooks),
            )
        ]
        try:
            with suppress(asyncio.CancelledError):
                await asyncio.gather(*tasks)
        finally:
            handlers = [self.server_tasks, *(circuit.tasks for circuit in self.circuits)]
            await end_tasks([*tasks, *(task for handler in handlers for task in handler.tasks)])
            for method in self.shutdown_methods.values():
                await method(self.async_layer)
            searches.close()
            self._claimed.tcp.close()

    async def server_accept_loop(self, sock: Any) -> None:
        """Listen for clients.

        Args:
            sock: Bound, listening.
        """

        def connected(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            client = Stream(reader, writer)
            self.server_tasks.create(self.tcp_handler(client, client.getpeername()))

        await asyncio.start_server(connected, sock=sock)
