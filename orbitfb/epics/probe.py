"""What a tester has beside the loop: PVs to follow tick by tick, and one to turn."""

from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Self

import numpy as np

from orbitfb.core.clock import SystemClock
from orbitfb.epics.channels import ChannelGroup
from orbitfb.epics.connecting import wait_for_channels
from orbitfb.epics.events import Monitor
from orbitfb.epics.libca import Context
from orbitfb.epics.network import environment_lock, use_network
from orbitfb.epics.orbit.assembler import Assembler
from orbitfb.epics.orbit.snapshot import Snapshot
from orbitfb.epics.pva.provider import pva_client
from orbitfb.epics.requests import Putter
from orbitfb.epics.settings import EpicsSettings


class Probe:
    """Follows a few PVs and writes another one, with a Channel Access context of its own.

    The slow channels of `EpicsMachine` are the last ones known when an orbit was complete; here
    every set of values that carries one stamp is seen, whatever the loop misses.

    Args:
        followed: PVs of one IOC that are stamped alike.
        knob: PV to write.
        settings: Network and time limits.
        take: Gets every coherent set, on libca's thread; it must return at once.

    Raises:
        ConnectError: PVs that cannot be reached, all of them.
        MachineError: The knob may not be written.
    """

    def __init__(
        self,
        followed: Sequence[str],
        knob: str,
        settings: EpicsSettings,
        take: Callable[[Snapshot], None],
    ) -> None:
        assembler = Assembler(len(followed), settings.stamp_window)

        def complete() -> None:
            take(assembler.snapshot())

        with environment_lock:
            use_network(settings)
            self._context = Context(pva_client(settings, (*followed, knob)))
            monitor = Monitor(assembler.records, assembler.arrived, complete)
            self._knob = ChannelGroup(self._context, (knob,))
            self._groups = (
                ChannelGroup(self._context, followed, monitor, assembler.set_connected),
                self._knob,
            )
            self._putter = Putter(self._context, self._knob)
            for group in self._groups:
                group.open()
        try:
            wait_for_channels(self._groups, self._knob, settings, SystemClock())
        except BaseException:
            self.close()
            raise

    def turn(self, value: float) -> None:
        """Write the knob, in the unit of the PV; it is not waited for.

        Raises:
            WriteError: The PV is away.
        """
        self._putter.put(np.array([value]), np.ones(1, dtype=np.bool_))

    def close(self) -> None:
        """Let go of them; nothing is taken any more when this returns."""
        for group in self._groups:
            group.forget()
        self._context.destroy()

    def __enter__(self) -> Self:
        """Return the probe itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Let go."""
        self.close()
