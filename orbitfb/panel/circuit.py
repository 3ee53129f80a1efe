"""One client of the panel: known by its address, bounded in what it sends and holds open."""

import asyncio
import socket
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from caproto import (
    MAX_TOTAL_SUBSCRIPTION_BACKLOG,
    CaprotoError,
    WriteNotifyRequest,
    WriteRequest,
)
from caproto.asyncio.server import VirtualCircuit

from orbitfb.core.clock import SystemClock
from orbitfb.core.connections import Connections
from orbitfb.panel.intake import Intake
from orbitfb.sim.access.context import ClaimedContext
from orbitfb.sim.access.listening import Sockets
from orbitfb.sim.access.queues import DroppingQueue
from orbitfb.sim.access.under_way import WritesUnderWay

MOST_CLIENTS = 128
"""Connections at a time; one more puts out the oldest of the host that has most."""
PATIENCE = 30.0
"""How long a client may have no channel, or take nothing of what it is sent [s]."""
WRITES_UNDER_WAY = 4
"""Writes of one client that are carried out at a time; the next ones wait, unread."""

_COMMANDS = 256
"""Messages of one client that wait for their turn."""
_CHUNK = 4096
_SHORTEST_BOUND = 8192
"""Longest message in any case: a name with its filters, a text [bytes]."""
_WIDEST = 40
"""What an element may take: a string of Channel Access [bytes]."""


class PanelCommands(asyncio.Queue[Any]):
    """A client's commands; a write waits until few enough of its writes are under way.

    Args:
        writes: That are under way.
    """

    def __init__(self, writes: WritesUnderWay) -> None:
        super().__init__(_COMMANDS)
        self._writes = writes

    async def get(self) -> Any:
        """Give the next one."""
        command = await super().get()
        if isinstance(command, WriteRequest | WriteNotifyRequest):
            await self._writes.below(WRITES_UNDER_WAY)
        return command


class PanelCircuit(VirtualCircuit):
    """A client that is known by the address of its connection, whatever name it claims.

    It is hung up on when it announces a message that nobody needs, writes faster than anybody
    can mean, holds more channels than there is use for, none at all, or takes nothing.
    """

    def __init__(self, circuit: Any, client: Any, context: "PanelContext") -> None:
        super().__init__(circuit, client, context)
        self.subscription_queue = DroppingQueue(MAX_TOTAL_SUBSCRIPTION_BACKLOG)
        # It does what caproto calls of its own, and counts.
        # pyrefly: ignore[bad-override-mutable-attribute]
        self.write_event = writes = WritesUnderWay()
        self.command_queue = PanelCommands(writes)
        self._panel, self._stream = context, client
        self._intake = Intake(context.longest, SystemClock())
        _watch(client.writer.get_extra_info("socket"))
        leaving = context.clients.add(self, self.client_hostname)
        if leaving is not None:
            leaving.hang_up()
        self._timer = asyncio.get_running_loop().call_later(PATIENCE, self._give_up)

    @property
    def client_hostname(self) -> str:
        """Where it is."""
        return str(self.circuit.address[0])

    @client_hostname.setter
    def client_hostname(self, claimed: str | None) -> None:
        """Take no notice of what it claims."""

    def hang_up(self) -> None:
        """End the connection there and then; what was to be sent is forgotten."""
        self._stream.hang_up()

    async def recv(self) -> None:
        """Take what the client sent, or hang up."""
        data = await self.client.recv(_CHUNK)
        if problem := self._intake.take(data) or self._too_many():
            self._panel.dropped(self.client_hostname, self.client_username or "", problem)
            self.hang_up()
            data = b""
        if not data:
            await super().recv()  # reads the end again, and acts on it
        commands, _ = self.circuit.recv(data)
        for command in commands:
            await self.command_queue.put(command)

    async def command_queue_loop(self) -> None:
        """Carry out what is asked for; a client that breaks the protocol is hung up on."""
        try:
            with suppress(KeyError, CaprotoError):  # a channel or subscription that is not there
                await super().command_queue_loop()
        finally:
            self.hang_up()

    def _too_many(self) -> str:
        held = len(self.circuit.channels) + sum(map(len, self.subscriptions.values()))
        most = self._panel.most_held
        return f"more than {most} channels and subscriptions" if held > most else ""

    def gone(self) -> None:
        """Watch it no longer."""
        self._timer.cancel()

    def _give_up(self) -> None:
        if not self.circuit.channels:
            self.hang_up()


def _watch(own: socket.socket) -> None:
    """Have the kernel end a connection whose other side is gone, or takes nothing."""
    own.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(1e3 * PATIENCE))
    own.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    own.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, round(PATIENCE))
    own.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, max(1, round(PATIENCE / 3)))


class PanelContext(ClaimedContext):
    """The server of the panel.

    Args:
        pvdb: The PVs by name.
        sockets: Where it listens.
        longest: Elements of the longest PV.
        dropped: Told of a client that was hung up on: its address, the user that it claims to be,
            why.

    Attributes:
        clients: Those who are connected.
        longest: Longest message of a client [bytes].
        most_held: Channels and subscriptions that a client may have: some screens at a time.
    """

    CircuitClass = PanelCircuit

    def __init__(
        self,
        pvdb: dict[str, Any],
        sockets: Sockets,
        longest: int,
        dropped: Callable[[str, str, str], None],
    ) -> None:
        super().__init__(pvdb, sockets)
        self.clients: Connections[PanelCircuit] = Connections(MOST_CLIENTS)
        self.longest = max(_SHORTEST_BOUND, _WIDEST * longest)
        self.most_held = 20 * len(pvdb)
        self.dropped = dropped

    async def circuit_disconnected(self, circuit: Any) -> None:
        """Count a client out."""
        circuit.gone()
        self.clients.remove(circuit)
        await super().circuit_disconnected(circuit)
