"""The thread that searches anew for channels that are away."""

import threading
from collections.abc import Callable, Sequence

from orbitfb.core.errors import MachineError
from orbitfb.epics.channels import ChannelGroup
from orbitfb.epics.libca import Context
from orbitfb.epics.network import repeater_stand_in


class Keeper:
    """Looks after the channels every period, on a thread of its own.

    Args:
        context: Context of the groups.
        groups: What to look after.
        period: Time between two looks [s].
        then: Called after each look, on the same thread.
    """

    def __init__(
        self,
        context: Context,
        groups: Sequence[ChannelGroup],
        period: float,
        then: Callable[[], None],
    ) -> None:
        self._context = context
        self._groups = tuple(groups)
        self._period = period
        self._then = then
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="epics-keeper", daemon=True)
        self.trouble = ""
        """What went wrong in the last look; empty if nothing did."""

    def start(self) -> None:
        """Begin to look."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread; returns when it has ended."""
        self._stopped.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        self._context.attach()
        while not self._stopped.wait(self._period):
            try:
                self._look()
                self.trouble = ""
            except MachineError as error:
                self.trouble = str(error)
        self._context.detach()

    def _look(self) -> None:
        repeater_stand_in().answer()
        for group in self._groups:
            group.reopen_away()
        self._then()
