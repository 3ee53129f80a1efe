"""Which server each PV comes from, and when it is another one than before.

The same PVs on two servers, such as a test IOC that was left running, are two machines: when one
of them dies, Channel Access goes on with the other, whose setpoints and orbit are different. libca
tells a server as `host:port`, and the host as a name or, until it has looked that up, as numbers.
A host is looked up when it is seen first, on a thread of its own: a silent name server
stops no tick. A spelling that was not found by then is another server.
"""

import socket
import threading
from collections import Counter
from collections.abc import Callable, Sequence

from orbitfb.epics.channels import ChannelGroup
from orbitfb.epics.libca import ECA_DOUBLED, ExceptionArguments

MOST_KEPT = 1000
"""Doubled PVs that are remembered: several times those of a ring; a flood must not fill memory."""


def spellings_of(host: str) -> frozenset[str]:
    """Look a host up, forwards and backwards; this may take as long as the name server.

    Args:
        host: A name or numbers.

    Returns:
        Names and numbers that are the same host; none if it is not known.
    """
    found: set[str] = set()
    for look_up in (socket.gethostbyname_ex, socket.gethostbyaddr):
        try:
            name, aliases, addresses = look_up(host)
        except (OSError, UnicodeError):
            continue
        found.update((name, *aliases, *addresses))
    return frozenset(found)


class Hosts:
    """Spellings of the hosts seen so far; asking never waits.

    Args:
        look_up: Gives the spellings of a host; called on a thread of its own, once for each host.
    """

    def __init__(self, look_up: Callable[[str], frozenset[str]]) -> None:
        self._look_up = look_up
        self._spellings: dict[str, frozenset[str]] = {}
        self._searches: list[threading.Thread] = []

    def meet(self, host: str) -> None:
        """See a host; look it up if that is the first time."""
        if host in self._spellings:
            return
        self._spellings[host] = frozenset({host})
        search = threading.Thread(
            target=self._search, args=(host,), name="host-look-up", daemon=True
        )
        self._searches = [one for one in self._searches if one.is_alive()] + [search]
        search.start()

    def settle(self, patience: float) -> None:
        """Wait for the searches that were begun.

        Args:
            patience: How long at most, for each [s].
        """
        for search in self._searches:
            search.join(patience)

    def are_same(self, one: str, other: str) -> bool:
        """Tell whether two hosts are known to be the same one."""
        return not self._all(one).isdisjoint(self._all(other))

    def _all(self, host: str) -> frozenset[str]:
        return self._spellings.get(host, frozenset({host}))

    def _search(self, host: str) -> None:
        self._spellings[host] = self._look_up(host) | {host}


class ServerWatch:
    """Looks at where channels are connected to; called by one thread.

    Args:
        groups: All channels.
        look_up: Gives the spellings of a host; may take long.
    """

    def __init__(
        self,
        groups: Sequence[ChannelGroup],
        look_up: Callable[[str], frozenset[str]] = spellings_of,
    ) -> None:
        self._groups, self.hosts = tuple(groups), Hosts(look_up)
        self._known = [[""] * len(group.servers) for group in groups]
        self._arrivals = [-1] * len(self._groups)
        self.changes = 0
        """How often a PV came back from another server."""
        self.told = ""
        """The last of these changes, in words."""

    def look(self) -> None:
        """Look at the channels that have come since the last look."""
        moved: Counter[tuple[str, str]] = Counter()
        for place, group in enumerate(self._groups):
            arrivals = group.arrivals
            if arrivals == self._arrivals[place]:
                continue
            self._arrivals[place] = arrivals
            known = self._known[place]
            for index, server in enumerate(group.servers):
                before = known[index]
                if server != before and server:
                    known[index] = server
                    self.hosts.meet(server.rpartition(":")[0])
                    if before and not self._is_same(before, server):
                        moved[before, server] += 1
        if moved:
            (before, now), count = moved.most_common(1)[0]
            self.changes += moved.total()
            self.told = (
                f"{count} PVs come from another server than before: {now} instead of {before}; "
                "see whether that is the machine, then close the loop"
            )

    def servers(self) -> dict[str, int]:
        """Count the PVs of each server."""
        self.look()
        return dict(Counter(server for known in self._known for server in known if server))

    def _is_same(self, one: str, other: str) -> bool:
        (host, _, port), (second, _, its) = one.rpartition(":"), other.rpartition(":")
        return port == its and self.hosts.are_same(host, second)


class Doubles:
    """PVs that more than one server has, as libca says it when it ignores the second answer."""

    def __init__(self) -> None:
        self._told: dict[str, str] = {}

    def hear(self, arguments: ExceptionArguments) -> None:
        """Take what libca says, on its thread."""
        if arguments.status == ECA_DOUBLED:
            self.heard((arguments.context or b"").decode("ascii", "replace"))

    def heard(self, text: str) -> None:
        """Take a message of libca: `Channel: "PV", Connecting to: A, Ignored: B`."""
        head, _, servers = text.partition(", Connecting to: ")
        if len(self._told) < MOST_KEPT:
            self._told.setdefault(head.partition('"')[2].rstrip('"') or head, servers)

    def describe(self) -> str:
        """Say which they are; empty when there is none."""
        if not self._told:
            return ""
        name, servers = next(iter(self._told.items()))
        count = len(self._told)
        return (
            f"{count} {'PVs are' if count > 1 else 'PV is'} on more than one server: {name} on "
            f"{servers.replace(', Ignored: ', ' and ')}, of which the first is used; stop the one "
            "that is not the machine, or leave its address out"
        )
