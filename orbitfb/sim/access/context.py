"""caproto's server on sockets that were claimed before, without beacons."""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any

from caproto.asyncio.server import Context

from orbitfb.sim.access.listening import Sockets
from orbitfb.sim.access.transport import Datagrams, Stream


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
            for task in tasks:
                task.cancel()
            await self.server_tasks.cancel_all()
            for circuit in self.circuits:
                await circuit.tasks.cancel_all()
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
