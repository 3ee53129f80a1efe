"""What carries the bytes of a Channel Access server: one datagram socket, one stream a client."""

import asyncio
from typing import Any, Protocol

from caproto import CaprotoNetworkError


class DatagramQueue(Protocol):
    """Where caproto waits for searches."""

    def put(self, value: Any) -> None:
        """Take one: interface, bytes, address."""
        ...


class Datagrams(asyncio.DatagramProtocol):
    """The socket for searches; one that an answer does not reach is that client's own affair.

    Args:
        interface: Where it listens.
        queue: Gets what comes in.
    """

    def __init__(self, interface: str, queue: DatagramQueue) -> None:
        self._interface, self._queue = interface, queue
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: Any) -> None:
        """Begin."""
        self._transport = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        """Hand a datagram to caproto."""
        if data:
            self._queue.put((self._interface, data, addr))

    async def sendto(self, data: bytes, address: Any) -> None:
        """Send to an address."""
        if self._transport is not None:
            self._transport.sendto(data, address)

    def close(self) -> None:
        """End."""
        if self._transport is not None:
            self._transport.close()


class Stream:
    """A client's connection. Once it is broken, or hung up on, it reads as ended.

    Args:
        reader: From the client.
        writer: To it.
    """

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self.writer = reader, writer
        self._one_at_a_time, self._over = asyncio.Lock(), False

    def getsockname(self) -> Any:
        """Give the address of this end."""
        return self.writer.get_extra_info("sockname")

    def getpeername(self) -> Any:
        """Give the address of the client."""
        return self.writer.get_extra_info("peername")

    async def send(self, data: bytes) -> None:
        """Send, and wait while the client takes nothing.

        Raises:
            CaprotoNetworkError: It is gone.
        """
        try:
            async with self._one_at_a_time:
                self.writer.write(data)
                await self.writer.drain()
        except OSError as error:
            raise CaprotoNetworkError(f"sending to {self.getpeername()}: {error}") from error

    async def recv(self, most: int = 4096) -> bytes:
        """Wait for bytes; none: it has ended."""
        if self._over:
            return b""
        try:
            return await self._reader.read(most)
        except OSError:
            return b""

    def hang_up(self) -> None:
        """End it there and then; what was sent or is to be sent is forgotten."""
        self._over = True
        self.writer.transport.abort()

    def close(self) -> None:
        """End it once all is sent."""
        self.writer.close()
