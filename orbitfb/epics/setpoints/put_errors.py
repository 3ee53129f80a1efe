"""What servers answer to puts that they refuse: a put is not acknowledged, a refusal is told."""

import threading

from orbitfb.core.names import NamedPv
from orbitfb.epics.channels import ChannelGroup
from orbitfb.epics.libca import Context, ExceptionArguments

OPERATION_PUT = 1
"""`CA_OP_PUT` of cadef.h."""


class PutErrors:
    """Keeps the last refusal of every setpoint until it is asked for.

    Args:
        context: Whose exceptions are listened to (`ca_add_exception_event`).
        group: The setpoints.
    """

    def __init__(self, context: Context, group: ChannelGroup) -> None:
        self._context, self._group = context, group
        self._heard: dict[int, str] = {}
        self._lock = threading.Lock()
        context.listeners.append(self.hear)
        group.put_refused = self._refused

    def hear(self, arguments: ExceptionArguments) -> None:
        """Take an exception of libca; called on its threads.

        Args:
            arguments: What it says; only refused puts to the setpoints are kept.
        """
        if arguments.operation != OPERATION_PUT or not arguments.channel:
            return
        number = self._context.library.ca_puser(arguments.channel) - 1
        pvs, handles = self._group.pvs, self._group.handles
        if 0 <= number < len(pvs) and handles[number] == arguments.channel:
            self._refused(pvs[number], self._context.message(arguments.status))

    def _refused(self, pv: NamedPv, words: str) -> None:
        with self._lock:
            self._heard.update(dict.fromkeys(pv.places.tolist(), f"refuses puts: {words}"))

    def take(self) -> dict[int, str]:
        """Return the refusals that came since the last call, by index, with those read-only now."""
        with self._lock:
            heard, self._heard = self._heard, {}
        group = self._group
        for index in (group.connected & ~group.writable).nonzero()[0].tolist():
            heard[index] = "may not be written"
        return heard
