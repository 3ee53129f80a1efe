"""caproto's server on sockets that were claimed before, without beacons."""

import asyncio
import functools
from typing import Any, NoReturn

from caproto.asyncio.server import Context
from caproto.asyncio.utils import _DatagramProtocol, _UdpTransportWrapper

from orbitfb.sim.access.listening import Sockets


class ClaimedContext(Context):
    """A server that speaks on its own two sockets and nowhere else.

    Args:
        pvdb: The PVs by name.
        sockets: Where it listens.
    """

    def __init__(self, pvdb: dict[str, Any], sockets: Sockets) -> None:
        super().__init__(pvdb, [sockets.interface])
        self.ca_server_port = sockets.port
        self._sockets = sockets

    async def _bind_tcp_sockets_with_consistent_port_number(self, make_socket: Any) -> Any:
        return self._sockets.port, {self._sockets.interface: self._sockets.tcp}

    async def _create_broadcaster_transport(self, interface: str) -> None:
        if interface in self.udp_socks:
            return  # made anew only where the system spoils a socket after an error; Linux does not
        transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
            functools.partial(
                _DatagramProtocol,
                parent=self,
                identifier=interface,
                queue=self.broadcaster_datagram_queue,
            ),
            sock=self._sockets.udp,
        )
        self.udp_socks[interface] = _UdpTransportWrapper(transport)

    async def broadcast_beacon_loop(self) -> NoReturn:
        """Send no beacons: on loopback there is no repeater, elsewhere nobody asked for them."""
        while True:
            await asyncio.get_running_loop().create_future()
