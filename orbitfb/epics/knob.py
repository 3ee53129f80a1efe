"""A PV to write beside those of the loop: what a tester turns."""

from types import TracebackType
from typing import Self

import numpy as np

from orbitfb.core.clock import SystemClock
from orbitfb.epics.channels import ChannelGroup
from orbitfb.epics.connecting import wait_for_channels
from orbitfb.epics.libca import Context
from orbitfb.epics.network import environment_lock, use_network
from orbitfb.epics.requests import Putter
from orbitfb.epics.settings import EpicsSettings


class Knob:
    """One PV that is written, with a Channel Access context of its own.

    Args:
        pv: Its name.
        settings: Network and time limits.

    Raises:
        ConnectError: It cannot be reached.
        MachineError: It may not be written.
    """

    def __init__(self, pv: str, settings: EpicsSettings) -> None:
        with environment_lock:
            use_network(settings)
            self._context = Context()
            self._group = ChannelGroup(self._context, (pv,))
            self._putter = Putter(self._context, self._group)
            self._group.open()
        try:
            wait_for_channels((self._group,), self._group, settings, SystemClock())
        except BaseException:
            self.close()
            raise

    def turn(self, value: float) -> None:
        """Write a value in the unit of the PV; it is not waited for.

        Raises:
            WriteError: The PV is away.
        """
        self._putter.put(np.array([value]))

    def close(self) -> None:
        """Let go of it."""
        self._group.forget()
        self._context.destroy()

    def __enter__(self) -> Self:
        """Return the knob itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Let go of it."""
        self.close()
