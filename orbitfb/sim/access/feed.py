"""What one client of the soft IOC is sent: whole orbits, or none."""

import asyncio
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Mask
from orbitfb.sim.access.board import Board
from orbitfb.sim.access.frames import Frames, Monitor


class Feed:
    """The monitors of one client, and its socket.

    A client that has not taken its last bytes yet, or that asked for silence, is skipped: it
    misses whole orbits, gets the newest one when it is back, and never slows the ring. Setpoints
    that it missed are sent as soon as it can take them.

    Args:
        board: Where the values are.
        transport: The client's connection.
        wanted: Says whether the client wants updates at present.
    """

    def __init__(
        self, board: Board, transport: asyncio.WriteTransport, wanted: Callable[[], bool]
    ) -> None:
        self._board = board
        self._transport = transport
        self._wanted = wanted
        self._monitors: dict[int, Monitor] = {}
        self._readings = Frames(())
        self._setpoints = Frames(())
        self._outdated = False
        self._pending: Mask = np.zeros(len(board.names), dtype=np.bool_)

    def add(self, monitor: Monitor) -> None:
        """Take a subscription and send the present value at once."""
        self._monitors[monitor.subscription] = monitor
        self._outdated = True
        if self._transport.is_closing():
            return
        if not self._wanted():
            self._pending[monitor.places] = True
            return
        first = Frames((monitor,))
        first.fill(self._board)
        self._transport.write(first.whole())

    def remove(self, subscription: int) -> None:
        """Drop a subscription; nothing is sent for it any more."""
        if self._monitors.pop(subscription, None) is not None:
            self._outdated = True

    def remove_channel(self, channel: int) -> None:
        """Drop all subscriptions of a channel that the client clears."""
        gone = [m.subscription for m in self._monitors.values() if m.channel == channel]
        for subscription in gone:
            self.remove(subscription)

    def send_readings(self) -> None:
        """Send the orbit as it stands, in one write, if the client can take it."""
        self._rebuild()
        if len(self._readings) and self._ready():
            self._readings.fill(self._board)
            self._transport.write(self._readings.whole())

    def mark(self, which: NDArray[np.intp]) -> None:
        """Note that setpoints have changed, indices of the board."""
        self._pending[which] = True

    def send_setpoints(self) -> None:
        """Send the setpoints that changed since they were last sent, in one write."""
        if not self._monitors or not self._pending.any():
            return
        self._rebuild()
        rows = self._setpoints.rows(self._pending)
        if not len(rows):
            self._pending[:] = False
        elif self._ready():
            self._setpoints.fill(self._board)
            self._transport.write(self._setpoints.part(rows))
            self._pending[:] = False

    def _ready(self) -> bool:
        transport = self._transport
        return (
            not transport.is_closing() and transport.get_write_buffer_size() == 0 and self._wanted()
        )

    def _rebuild(self) -> None:
        if not self._outdated:
            return
        border = self._board.readings
        monitors = self._monitors.values()
        self._readings = Frames([m for m in monitors if m.places[0] < border])
        self._setpoints = Frames([m for m in monitors if m.places[0] >= border])
        self._outdated = False
