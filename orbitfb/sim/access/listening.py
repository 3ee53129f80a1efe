"""Take the port for oneself alone, or say who cannot have it.

caproto shares the UDP port with whoever has it and silently takes another TCP port when its own is
gone, so that two soft IOCs would answer for the same PVs. Here both sockets are bound before
caproto starts: UDP without any sharing, TCP listening, with SO_REUSEADDR so that a restart does
not wait for the connections of its predecessor to time out.
"""

import contextlib
import errno
import socket
from dataclasses import dataclass

from orbitfb.core.errors import OwnershipError

_BACKLOG = 64
_TRIES = 50


@dataclass(frozen=True, slots=True)
class Sockets:
    """Both sockets of a Channel Access server, bound."""

    interface: str
    port: int
    tcp: socket.socket
    udp: socket.socket

    def close(self) -> None:
        """Give the port back."""
        self.tcp.close()
        self.udp.close()


def claim(
    interface: str, port: int, send_buffer: int | None = None, section: str = "sim"
) -> Sockets:
    """Bind the TCP and the UDP port of a server.

    Args:
        interface: Address to listen on.
        port: Port for both; 0 for any free one.
        send_buffer: Socket buffer for each client [bytes]; None leaves the system's, and
            leaves Nagle's delay on as well, as caproto does.
        section: Of the configuration, for advice.

    Raises:
        OwnershipError: Somebody else has the port, or the address is not of this computer.
    """
    for _ in range(_TRIES):
        sockets = _try_claim(interface, port, send_buffer, section)
        if sockets is not None:
            return sockets
    raise OwnershipError(
        f"no port is free for both TCP and UDP on {interface}; name one with {section}.port"
    )


def _try_claim(interface: str, port: int, send_buffer: int | None, section: str) -> Sockets | None:
    with contextlib.ExitStack() as undo:
        # asyncio turns Nagle's delay off (40 ms per orbit) only on sockets that name the protocol.
        protocol = 0 if send_buffer is None else socket.IPPROTO_TCP
        tcp = undo.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM, protocol))
        udp = undo.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        tcp.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if send_buffer is not None:
            tcp.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, send_buffer)
        try:
            tcp.bind((interface, port))
            tcp.listen(_BACKLOG)
            udp.bind((interface, tcp.getsockname()[1]))
        except OSError as error:
            if error.errno == errno.EADDRINUSE and port == 0:
                return None
            raise OwnershipError(_explain(interface, port, error, section)) from error
        tcp.setblocking(False)
        udp.setblocking(False)
        undo.pop_all()
        return Sockets(interface, tcp.getsockname()[1], tcp, udp)


def _explain(interface: str, port: int, error: OSError, section: str) -> str:
    if error.errno == errno.EADDRINUSE:
        return (
            f"port {port} on {interface} is in use, by another IOC perhaps; stop that one "
            f"or choose another {section}.port (0 takes any free one)"
        )
    return f"cannot listen on {interface} port {port}: {error.strerror}; see {section}.interface"
