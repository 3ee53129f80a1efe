"""The front that keeps up: values on a board, one write per client and tick."""

import asyncio
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from caproto import SubscriptionType
from numpy.typing import NDArray

from orbitfb.core.names import NamedPv, named_pvs
from orbitfb.core.signals import Mask, Vector
from orbitfb.sim.access.arrays import BoardArray, BoardArraySetpoint
from orbitfb.sim.access.board import Board
from orbitfb.sim.access.channels import (
    BoardChannel,
    BoardReading,
    BoardSetpoint,
    Watched,
    knob_channels,
    lease_channels,
)
from orbitfb.sim.access.circuit import FastContext
from orbitfb.sim.access.feed import Feed
from orbitfb.sim.access.listening import Sockets
from orbitfb.sim.access.pva import PvaArrays
from orbitfb.sim.access.stamp import Stamp, now
from orbitfb.sim.layout import Layout, PvSpec

_ALL_EVENTS = SubscriptionType.DBE_VALUE | SubscriptionType.DBE_LOG | SubscriptionType.DBE_ALARM


class FastFront:
    """Serves a ring from a board.

    Args:
        layout: The PVs.
        turned: What a write to a knob does: its PV, and the value in its units.

    Attributes:
        board: Values, stamps and alarms.
        feeds: One per client that is connected.
        pva: Arrays over pvAccess; None: there are none.
        on_written: Called when setpoints have been written.
    """

    def __init__(self, layout: Layout, turned: Callable[[str, float], None]) -> None:
        self.board = Board(layout, now())
        self.feeds: set[Feed] = set()
        self.on_written: Callable[[], None] = lambda: None
        specs = (*layout.readings, *layout.setpoints)
        pvs = named_pvs(self.board.names)
        self._channels = self._make_channels(pvs, specs)
        over_pva = [pv for pv in pvs if pv.over_pva]
        self.pva = PvaArrays(over_pva, specs, self.board, self.put) if over_pva else None
        self._knobs = knob_channels(layout, turned)
        self._leases = lease_channels(layout.planes)
        self._taken = False
        self._watched: set[Watched] = set()
        self._stale: set[Watched] = set()
        self._publishing: asyncio.Task[None] | None = None

    @property
    def setpoints(self) -> Vector:
        """Setpoints in force, in the order and the units of the layout: a copy."""
        return self.board.setpoints.copy()

    @property
    def written(self) -> Mask:
        """Setpoints that were written since the last `show`, shape (m,): a copy."""
        return self.board.written.copy()

    @property
    def busy(self) -> bool:
        """Never: a write to a socket does not wait."""
        return False

    def show(self, values: Vector, stamp: Stamp) -> None:
        """Publish the readings of a tick."""
        self.board.show(values, stamp)
        self.board.written[:] = False
        if self.pva is not None:
            self.pva.show(readings=True)
        for feed in self.feeds:
            feed.send_readings()
            feed.send_setpoints()
        self._publish({c for c in self._watched if c.places[0] < self.board.readings})

    def take(self, which: NDArray[np.intp], values: Vector) -> None:
        """Put setpoints in force that are within their limits."""
        self.board.write(which, values, now())
        at = which + self.board.readings
        for feed in self.feeds:
            feed.mark(at)
        self._publish({c for c in self._watched if np.isin(c.places, at).any()})
        self._taken = True

    def puts_taken(self) -> None:
        """Tell everybody what was taken, once for all that came together."""
        if self._taken:
            self._taken = False
            self._tell_setpoints()

    def put(self, which: NDArray[np.intp], values: Vector) -> None:
        """Put setpoints in force that are within their limits, and tell all clients."""
        self.take(which, values)
        self.puts_taken()

    def watch(self, channel: Watched, watched: bool) -> None:
        """Learn whether caproto itself has to be told of this channel's updates."""
        if watched:
            self._watched.add(channel)
        else:
            self._watched.discard(channel)

    def changed(self, index: int, accepted: bool) -> None:
        """Learn that a setpoint was written, or refused, through caproto."""
        if accepted:
            self.board.written[index - self.board.readings] = True
        for feed in self.feeds:
            feed.mark(np.array([index]))
        self._tell_setpoints()

    def context(self, sockets: Sockets) -> FastContext:
        """Make the caproto server that serves it."""
        pvdb: dict[str, Any] = {channel.pv: channel for channel in self._channels}
        return FastContext(pvdb | self._knobs | self._leases, sockets, self)

    def _make_channels(
        self, pvs: Sequence[NamedPv], specs: Sequence[PvSpec]
    ) -> list[BoardChannel | BoardArray]:
        board = self.board
        channels: list[BoardChannel | BoardArray] = []
        for pv in pvs:
            if pv.over_pva:
                continue
            first = int(pv.places[0])
            is_reading, spec = first < board.readings, specs[first]
            if pv.elements is None:
                scalar = BoardReading if is_reading else BoardSetpoint
                channels.append(scalar(spec, board, first, self))
            else:
                array = BoardArray if is_reading else BoardArraySetpoint
                places = pv.places[np.argsort(pv.elements)]
                channels.append(array(pv.name, spec, board, places, self))
        return channels

    def _tell_setpoints(self) -> None:
        for feed in self.feeds:
            feed.send_setpoints()
        if self.pva is not None:
            self.pva.show(readings=False)
        self.on_written()

    def _publish(self, channels: set[Watched]) -> None:
        """Tell caproto of what it serves itself; updates that it is late for are merged."""
        if not channels:
            return
        self._stale |= channels
        if self._publishing is None or self._publishing.done():
            self._publishing = asyncio.get_running_loop().create_task(self._publish_stale())

    async def _publish_stale(self) -> None:
        while self._stale:
            channel = self._stale.pop()
            await channel.pull(_ALL_EVENTS)
