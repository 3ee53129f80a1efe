"""PVs that come from another server than before, and PVs that two servers have."""

import threading
from typing import Any

from orbitfb.epics.servers import Doubles, ServerWatch

HOSTS = {
    "ioc-a": frozenset({"ioc-a", "10.0.0.1"}),
    "10.0.0.1": frozenset({"ioc-a", "10.0.0.1"}),
    "ioc-b": frozenset({"10.0.0.2"}),
}


class Group:
    """As much of a group of channels as is looked at."""

    def __init__(self, count: int) -> None:
        self.servers, self.arrivals = [""] * count, 0

    def __len__(self) -> int:
        return len(self.servers)


def watched(count: int = 3):
    group: Any = Group(count)
    watch = ServerWatch([group], lambda host: HOSTS.get(host, frozenset()))
    watch.look()
    return group, watch


def come(group: Any, watch: ServerWatch, *servers: str) -> int:
    for index, server in enumerate(servers):
        group.servers[index] = server
        group.arrivals += 1
    before = watch.changes
    watch.look()
    watch.hosts.settle(10.0)
    return watch.changes - before


def test_the_first_server_and_the_same_again_are_no_change():
    group, watch = watched()
    assert come(group, watch, "ioc-a:5064", "ioc-a:5064", "ioc-b:5064") == 0
    assert come(group, watch, "ioc-a:5064", "ioc-a:5064", "ioc-b:5064") == 0
    assert watch.servers() == {"ioc-a:5064": 2, "ioc-b:5064": 1}
    assert not watch.told


def test_another_host_or_port_is_a_change_and_is_told_once():
    group, watch = watched()
    come(group, watch, "ioc-a:5064", "ioc-a:5064", "ioc-a:5064")
    assert come(group, watch, "ioc-b:5064", "ioc-b:5064") == 2
    assert "2 PVs" in watch.told and "ioc-b:5064 instead of ioc-a:5064" in watch.told
    assert come(group, watch, "ioc-b:5099") == 1
    assert come(group, watch) == 0


def test_a_host_that_is_not_looked_up_yet_is_the_same_as_its_name():
    """libca tells numbers until its own look-up has ended."""
    group, watch = watched()
    come(group, watch, "10.0.0.1:5064", "ioc-a:5064", "10.0.0.9:5064")
    assert come(group, watch, "ioc-a:5064", "10.0.0.1:5064", "10.0.0.9:5064") == 0
    assert come(group, watch, "10.0.0.2:5064", "10.0.0.2:5064", "ioc-x:5064") == 3


def test_a_silent_name_server_stops_no_tick_and_an_unknown_spelling_is_another_server():
    answered = threading.Event()

    def look_up(host: str) -> frozenset[str]:
        answered.wait(10.0)
        return HOSTS.get(host, frozenset())

    group: Any = Group(1)
    watch = ServerWatch([group], look_up)
    for server, changes in (("10.0.0.1:5064", 0), ("ioc-a:5064", 1)):
        group.servers[0], group.arrivals = server, group.arrivals + 1
        watch.look()
        assert watch.changes == changes
    answered.set()
    watch.hosts.settle(10.0)
    assert come(group, watch, "10.0.0.1:5064") == 0


def test_what_libca_says_of_doubled_pvs_is_put_into_words():
    doubles = Doubles()
    assert not doubles.describe()
    said = 'Channel: "BPM:1:X", Connecting to: ioc-a:5064, Ignored: ioc-b:5064'
    doubles.heard(said)
    doubles.heard(said)
    assert doubles.describe().startswith(
        "1 PV is on more than one server: BPM:1:X on ioc-a:5064 and ioc-b:5064"
    )
    doubles.heard(said.replace("BPM:1", "BPM:2"))
    assert doubles.describe().startswith("2 PVs are on more than one server")
