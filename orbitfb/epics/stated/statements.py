"""What PVs state of themselves beside their values: unit and limits, told when they change."""

import ctypes

from orbitfb.epics.libca import EventArguments

STATED = slice(4, 80)
"""Bytes of a `dbr_ctrl_double` between alarm and value: precision, unit and limits."""
IDLE = 4
"""Events in one look that state nothing new and are let pass. The severities of four limits of a
record are properties that these events do not carry: editing all of them makes four."""


class Statements:
    """Tells an event that states something new from one that repeats what is known.

    EPICS base sends events of properties when a property changes. Others, as caproto 1.3, send one
    with every value: twice the events of a ring, and nothing new in them. Such subscriptions are to
    be ended; what the PV states is then seen when it comes back from an outage.

    Args:
        size: Number of PVs.
    """

    def __init__(self, size: int) -> None:
        self._known = [b""] * size
        self._idle = [0] * size

    def came(self, number: int) -> None:
        """Note that a PV has come: its next event states what it has, nothing new."""
        self._known[number] = b""

    def is_new(self, number: int, arguments: EventArguments) -> bool:
        """Tell whether an event states another unit or other limits than the one before.

        Args:
            number: Of the PV, from 0 on.
            arguments: The event, a `dbr_ctrl_double`.
        """
        stated = ctypes.string_at(arguments.data, STATED.stop)[STATED]
        before, self._known[number] = self._known[number], stated
        self._idle[number] += stated == before
        return before not in (b"", stated)

    def repeating(self) -> list[int]:
        """Give the PVs that repeated themselves since the last call, and begin to count anew."""
        counts, self._idle[:] = self._idle.copy(), [0] * len(self._idle)
        return [number for number, idle in enumerate(counts) if idle > IDLE]
