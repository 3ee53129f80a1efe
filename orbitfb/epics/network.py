"""The Channel Access environment of this process, and a stand-in for the CA repeater."""

import atexit
import os
import socket
import struct
import threading

from orbitfb.core.errors import MachineError
from orbitfb.epics.settings import EpicsSettings

REPEATER_REGISTER = 24
REPEATER_CONFIRM = 17
HEADER = struct.Struct(">HHHHII")

environment_lock = threading.RLock()
"""Held from `use_network` until the context that is to read the environment has searched."""


class RepeaterStandIn:
    """Keeps libca from spawning a `caRepeater`, and from complaining that there is none.

    libca tries to start the program `caRepeater` when nobody holds the repeater's UDP port, and
    prints four lines on stderr, out of Python's reach, when it is not installed. All it would do
    is to pass on the beacons of servers that come back, and channels that are away are searched
    anew periodically anyway. So this process holds a port on loopback itself and confirms
    registrations; no beacon is passed on, nothing is ever sent to anybody but libca in this
    process.
    """

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind(("127.0.0.1", 0))
        self.port: int = self._socket.getsockname()[1]

    def answer(self) -> None:
        """Confirm the registrations that have come; never waits."""
        while True:
            try:
                request, sender = self._socket.recvfrom(64)
            except (BlockingIOError, ConnectionError):
                return
            if not request or HEADER.unpack_from(request.ljust(HEADER.size, b"\0"))[0] in (
                0,
                REPEATER_REGISTER,
            ):
                address = struct.unpack(">I", socket.inet_aton(sender[0]))[0]
                confirmation = HEADER.pack(REPEATER_CONFIRM, 0, 0, 0, 0, address)
                self._socket.sendto(confirmation, sender)

    def close(self) -> None:
        """Give the port back."""
        self._socket.close()


_stand_ins: dict[int, RepeaterStandIn] = {}


def repeater_stand_in() -> RepeaterStandIn:
    """Return this process's stand-in; made at the first call, and anew after a fork."""
    with environment_lock:
        process = os.getpid()
        if process not in _stand_ins:
            for inherited in _stand_ins.values():
                inherited.close()
            _stand_ins.clear()
            try:
                stand_in = RepeaterStandIn()
            except OSError as cause:
                message = f"cannot bind a UDP port on 127.0.0.1 for Channel Access: {cause}"
                raise MachineError(message) from cause
            _stand_ins[process] = stand_in
            atexit.register(stand_in.close)
        return _stand_ins[process]


def use_network(settings: EpicsSettings) -> None:
    """Set the Channel Access environment of this process.

    libca reads it when a context is made and searches for its first channel. Each `EpicsMachine`
    has a context of its own, so each one uses its own settings, whatever was used before in this
    process; nothing that is already connected changes.

    Args:
        settings: Where to search and how long to wait.
    """
    with environment_lock:
        os.environ["EPICS_CA_ADDR_LIST"] = settings.address_list
        os.environ["EPICS_CA_AUTO_ADDR_LIST"] = "YES" if settings.auto_address_list else "NO"
        os.environ["EPICS_CA_SERVER_PORT"] = str(settings.server_port)
        os.environ["EPICS_CA_CONN_TMO"] = str(settings.circuit_timeout)
        os.environ["EPICS_CA_REPEATER_PORT"] = str(repeater_stand_in().port)
        # The settings say where to look; a name server left over from the shell would add to it.
        os.environ.pop("EPICS_CA_NAME_SERVERS", None)
        if settings.name_servers:
            os.environ["EPICS_CA_NAME_SERVERS"] = settings.name_servers
