"""The thread that searches anew for channels that are away.

A search anew drops the answers to the one before. Where a server or a network needs longer for its
answers than the time between two searches, no channel would ever come: so what is away is left
alone while others come, and searched for less often as long as nothing does.
"""

import threading
from collections.abc import Callable, Sequence

import numpy as np

from orbitfb.core.errors import MachineError
from orbitfb.epics.channels import ChannelGroup
from orbitfb.epics.libca import Context
from orbitfb.epics.network import repeater_stand_in

LONGEST = 4.0
"""Longest time between two searches, unless the period is longer [s]."""


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
        self._wait, self._came = period, 0
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
        while not self._stopped.wait(self._wait):
            try:
                self.look()
                self.trouble = ""
            except MachineError as error:
                self.trouble = str(error)
        self._context.detach()

    def look(self) -> float:
        """Look after the channels; return the time until the next look [s]."""
        repeater_stand_in().answer()
        came = sum(int(np.count_nonzero(group.connected)) + group.losses for group in self._groups)
        if all(group.all_connected for group in self._groups):
            self._wait = self._period
        elif came <= self._came:
            for group in self._groups:
                group.reopen_away()
            self._wait = min(2.0 * self._wait, max(self._period, LONGEST))
        self._came = came
        self._then()
        return self._wait
