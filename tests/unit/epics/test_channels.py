"""Who may be written, as libca's events tell it."""

from types import SimpleNamespace
from typing import Any

from orbitfb.epics.channels import ChannelGroup
from orbitfb.epics.libca import (
    OPERATION_UP,
    WRITE_ACCESS,
    AccessArguments,
    ConnectionArguments,
)

DOWN = OPERATION_UP + 1


class Library:
    """As much of libca as the handlers of events use; a channel's handle is its place."""

    def ca_puser(self, channel: int) -> int:
        return channel

    def ca_write_access(self, _channel: int) -> int:
        return 1


def test_a_circuit_that_answers_again_without_an_access_event_is_writable():
    """libca takes the rights away by an event when a server is silent; none gives them back."""
    context: Any = SimpleNamespace(library=Library(), host_of=lambda _: "here:5064", telling=None)
    group = ChannelGroup(context, ("A",))
    group._on_access(AccessArguments(1, WRITE_ACCESS))
    group._on_connection(ConnectionArguments(1, OPERATION_UP))
    assert group.connected[0] and group.writable[0]
    group._on_connection(ConnectionArguments(1, DOWN))
    group._on_access(AccessArguments(1, 0))
    assert not group.connected[0] and not group.writable[0]
    group._on_connection(ConnectionArguments(1, OPERATION_UP))
    assert group.connected[0] and group.writable[0]
