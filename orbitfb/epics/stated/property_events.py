"""Subscriptions of a group to units and limits."""

import ctypes
import threading
from collections.abc import Callable

from orbitfb.epics.events import guarded
from orbitfb.epics.libca import (
    DBR_CTRL_DOUBLE,
    ECA_NORMAL,
    EVENT_HANDLER,
    MONITOR_PROPERTY,
    Context,
    EventArguments,
)
from orbitfb.epics.stated.statements import Statements


class PropertyEvents:
    """Hears when PVs state another unit or other limits.

    Args:
        context: Of the channels.
        size: Number of PVs.
        restated: Called when one does, on libca's threads.
    """

    def __init__(self, context: Context, size: int, restated: Callable[[], None]) -> None:
        self._context, self._restated = context, restated
        self._statements = Statements(size)
        self._events: list[int | None] = [None] * size
        # libca keeps its address: it must live as long as the context.
        self._handler = EVENT_HANDLER(guarded(self._on_event, context.telling))

    def subscribe(self, number: int, name: str, handle: ctypes.c_void_p) -> None:
        """Subscribe to a channel that was created just now.

        Args:
            number: Of the PV, from 0 on.
            name: Of the PV.
            handle: Of its channel.

        Raises:
            MachineError: libca refuses.
        """
        what = (DBR_CTRL_DOUBLE, 1, MONITOR_PROPERTY)
        self._events[number] = self._context.subscribe(
            name, handle, what, self._handler, number + 1
        )

    def came(self, number: int) -> None:
        """Note that a PV has come: its next event states what it has, nothing new."""
        self._statements.came(number)

    def end_repeating(self, lock: threading.Lock) -> None:
        """End the subscriptions whose events state nothing new.

        Args:
            lock: Of the group: no channel is created anew meanwhile.
        """
        repeating = self._statements.repeating()
        if not repeating:
            return
        with lock:
            for number in repeating:
                event, self._events[number] = self._events[number], None
                if event is not None:
                    self._context.library.ca_clear_subscription(event)
        self._context.flush()

    def _on_event(self, arguments: EventArguments) -> None:
        if arguments.status == ECA_NORMAL and self._statements.is_new(
            arguments.user - 1, arguments
        ):
            self._restated()
