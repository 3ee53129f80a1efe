"""The reference front: caproto's documented calls alone. Slow, and right by construction."""

import asyncio
from collections.abc import Callable
from typing import Any

import numpy as np
from caproto import AlarmSeverity, AlarmStatus

from orbitfb.core.signals import Mask, Vector
from orbitfb.sim.access.channels import (
    ReadOnlyChannel,
    ScalarChannel,
    knob_channels,
    lease_channels,
)
from orbitfb.sim.access.context import ClaimedContext
from orbitfb.sim.access.listening import Sockets
from orbitfb.sim.access.pva import PvaArrays
from orbitfb.sim.access.stamp import Stamp
from orbitfb.sim.layout import Layout, PvSpec


class PlainSetpoint(ScalarChannel):
    """A setpoint that tells when it has been written."""

    def __init__(self, spec: PvSpec, written: Callable[[], None]) -> None:
        super().__init__(spec, spec.initial)
        self._written = written

    async def write(self, value: Any, **options: Any) -> None:
        """Take the value or refuse it."""
        await super().write(value, **options)
        self._written()


class PlainFront:
    """Serves a ring by writing to its channels one by one.

    Args:
        layout: The PVs.
        turned: What a write to a knob does: its PV, and the value in its units.

    Attributes:
        on_written: Called when a setpoint has been written.
        pva: There are no arrays.
    """

    def __init__(self, layout: Layout, turned: Callable[[str, float], None]) -> None:
        self.on_written: Callable[[], None] = lambda: None
        self.pva: PvaArrays | None = None
        self._names = layout
        self._readings = [ReadOnlyChannel(spec) for spec in layout.readings]
        self._written: Mask = np.zeros(len(layout.setpoints), dtype=np.bool_)
        self._setpoints = [
            PlainSetpoint(spec, lambda index=index: self._note(index))
            for index, spec in enumerate(layout.setpoints)
        ]
        self._knobs = knob_channels(layout, turned)
        self._publishing: asyncio.Task[None] | None = None

    @property
    def setpoints(self) -> Vector:
        """Setpoints in force, in the order and the units of the layout."""
        return np.array([float(channel.value) for channel in self._setpoints])

    @property
    def written(self) -> Mask:
        """Setpoints that were written since the last `show`, shape (m,): a copy."""
        return self._written.copy()

    @property
    def busy(self) -> bool:
        """Whether the last orbit is still being written."""
        return self._publishing is not None and not self._publishing.done()

    def show(self, values: Vector, stamp: Stamp) -> None:
        """Publish the readings of a tick."""
        self._written[:] = False
        self._publishing = asyncio.get_running_loop().create_task(self._publish(values, stamp))

    def context(self, sockets: Sockets) -> ClaimedContext:
        """Make the caproto server that serves it."""
        layout = self._names
        names = [spec.name for spec in (*layout.readings, *layout.setpoints)]
        pvdb: dict[str, Any] = dict(zip(names, [*self._readings, *self._setpoints], strict=True))
        return ClaimedContext(pvdb | self._knobs | lease_channels(layout.planes), sockets)

    async def _publish(self, values: Vector, stamp: Stamp) -> None:
        for channel, value in zip(self._readings, values.tolist(), strict=True):
            if np.isfinite(value):
                await channel.write(value, timestamp=stamp)
            else:
                await channel.write(
                    value,
                    timestamp=stamp,
                    verify_value=False,
                    status=AlarmStatus.UDF,
                    severity=AlarmSeverity.INVALID_ALARM,
                )

    def _note(self, index: int) -> None:
        self._written[index] = True
        self.on_written()
