"""Ports of loopback that are free and stay so: neither the kernel nor another worker gives them.

A port that the kernel gave out may have gone to somebody else by the time that it is bound again;
a test that starts a server anew on its port binds it twice.
"""

import os
import random
import socket

NOT_OF_THE_KERNEL = range(12_000, 32_000)
"""Linux gives out 32768 to 60999 of its own accord (`ip_local_port_range`)."""
SHARE = 1_000
"""Ports that a worker of pytest-xdist has for itself; it takes each once, then begins anew."""

_given = random.randrange(SHARE)  # two runs of the tests on one computer begin elsewhere


def free_port() -> int:
    """Give a port that is free for TCP and UDP, another one at every call."""
    global _given
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    shares = len(NOT_OF_THE_KERNEL) // SHARE
    begin = NOT_OF_THE_KERNEL.start + worker % shares * SHARE
    for _ in range(SHARE):
        _given += 1
        port = begin + _given % SHARE
        with socket.socket() as tcp, socket.socket(type=socket.SOCK_DGRAM) as udp:
            tcp.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                tcp.bind(("127.0.0.1", port))
                udp.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise OSError(f"no port of {begin} to {begin + SHARE - 1} is free")
