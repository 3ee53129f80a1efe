"""The names by which this computer may be asked, against other sites' pages in a browser here.

A page that a browser got elsewhere can ask this computer too, under a name that its owner lets
point here (DNS rebinding). It comes with that name in `Host`. An address needs no name server,
so that nobody else can make one point here.
"""

import ipaddress
import socket
from collections.abc import Iterable
from urllib.parse import urlsplit


class HostNames:
    """Names of ours.

    Args:
        host: What is listened on.
        names: More of them, from the configuration.
    """

    def __init__(self, host: str, names: Iterable[str] = ()) -> None:
        own = ("localhost", socket.gethostname(), host, *names)
        self._names = frozenset(name.lower().rstrip(".") for name in own)

    def knows(self, host: str) -> bool:
        """Say whether a `Host` is a name of ours, or an address.

        Args:
            host: Of the header, with or without a port.
        """
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        if name.rstrip(".") in self._names:
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True
