"""The RF behind Channel Access: `orbitfb.core.ports.Oscillator`."""

import math

import numpy as np

from orbitfb.core.errors import WriteError
from orbitfb.epics.channels import ChannelGroup
from orbitfb.epics.libca import Context
from orbitfb.epics.requests import Getter, Putter

ONE = np.ones(1, dtype=np.bool_)
HERTZ = "Hz"


class EpicsOscillator:
    """Sets the frequency; its drive limits are read when it connects and after it was away.

    Args:
        context: Where the channel lives.
        pv: Of the setpoint [Hz].
        timeout: How long to wait for an answer [s].
    """

    def __init__(self, context: Context, pv: str, timeout: float) -> None:
        self.group = ChannelGroup(context, (pv,), changed=self._changed)
        self._getter = Getter(context, self.group, timeout)
        self._putter = Putter(context, self.group)
        self._limits = (math.nan, math.nan)
        self._due = True

    @property
    def limits(self) -> tuple[float, float]:
        """Drive limits that the server states, low and high [Hz]; NaN: none, or not known yet."""
        return self._limits

    def put(self, frequency: float) -> None:
        """Send a setpoint [Hz].

        Raises:
            WriteError: It is away or read-only, or its drive limits have not been read since it
                was away; nothing was sent.
        """
        if self._due:
            raise WriteError(f"{self.group.names[0]} was away and has not been read since")
        self._putter.put(np.array([frequency]), ONE)

    def refresh(self) -> None:
        """Read the drive limits if they may have changed; waits for an answer."""
        if self._due and self.group.all_connected:
            self._due = False
            low, high = self._getter.limits()[0]
            self._limits = (float(low), float(high))

    def contradiction(self) -> str:
        """Say that the PV states another unit than Hz; empty: it does not."""
        [unit] = self._getter.units()
        if not unit.strip() or unit.strip() == HERTZ:
            return ""
        return (
            f"{self.group.names[0]} states the unit {unit.strip()!r} (EGU), but a setpoint in "
            f"{HERTZ} is needed; name a PV in {HERTZ} with rf.setpoint_pv"
        )

    def _changed(self, _index: int, _up: bool) -> None:
        self._due = True
