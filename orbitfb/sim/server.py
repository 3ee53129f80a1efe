"""The soft IOC: a ring that ticks, and its PVs."""

import asyncio

import numpy as np

from orbitfb.core.signals import Mask
from orbitfb.sim.access.fast import FastFront
from orbitfb.sim.access.frames import UPDATE_SIZE
from orbitfb.sim.access.front import Front
from orbitfb.sim.access.listening import claim
from orbitfb.sim.access.plain import PlainFront
from orbitfb.sim.access.stamp import now
from orbitfb.sim.layout import KICK_PV, MILLI, lay_out
from orbitfb.sim.ring import SimulatedRing
from orbitfb.sim.served import Announce, Served
from orbitfb.sim.settings import SimSettings
from orbitfb.sim.ticker import Ticker, start_ticker

_PATIENCE = 0.3
"""How long caproto may take to stop [s]."""


class RingServer:
    """A ring that advances by the clock, or by its setpoints, and is shown to clients.

    Args:
        ring: The simulated ring.
        settings: Rate, limits, kind of front.

    Attributes:
        failed: Fails when a tick does: a ring that stands still must not look alive.
    """

    def __init__(self, ring: SimulatedRing, settings: SimSettings) -> None:
        self._ring = ring
        self._settings = settings
        self.layout = lay_out(ring.channels, settings)
        kind = PlainFront if settings.plain else FastFront
        self.front: Front = kind(self.layout, self._turned)
        self._stored = self.layout.stored.initial
        self._ticker: Ticker | None = None
        self._correctors = slice(self.layout.correctors)
        self._awaited: Mask = np.ones(self.layout.correctors, dtype=np.bool_)
        self.failed: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def start(self) -> None:
        """Make the first tick and go on from there."""
        self.tick()
        self._ticker = start_ticker(1.0 / self._settings.rate_hz, self.tick)
        if self._settings.lockstep:
            self.front.on_written = self._tick_if_complete

    def stop(self) -> None:
        """Stand still."""
        self.front.on_written = lambda: None
        if self._ticker is not None:
            self._ticker.stop()

    def tick(self) -> None:
        """Advance the ring by one tick and publish it; left out while the last is under way."""
        if self.front.busy or self.failed.done():
            return
        stamp = now()
        written = self.front.written[self._correctors]
        if written.any():
            self._awaited = written
        try:
            setpoints = self.front.setpoints
            rf = float(setpoints[-1])
            state = self._ring.step(setpoints[self._correctors], rf - self.layout.rf_frequency)
            values = self.layout.values(state, self._ring.tick, self._stored, rf)
            self.front.show(values, stamp)
        except Exception as error:  # `serve` raises it; event loop and clients would swallow it
            self.failed.set_exception(error)

    def _tick_if_complete(self) -> None:
        """Tick once all have come that came before: a controller may leave some alone."""
        if self.front.busy or (self._awaited & ~self.front.written[self._correctors]).any():
            return
        self.tick()
        if self._ticker is not None:
            self._ticker.restart()

    def _turned(self, pv: str, value: float) -> None:
        """Do what a knob of the tester's says, in its units."""
        if pv == KICK_PV:
            self._ring.kick(value / MILLI)
        else:
            self._stored = value


def send_buffer(ring: SimulatedRing, settings: SimSettings) -> int | None:
    """Make room for a whole tick: the rest of a longer one waits 40 ms for an acknowledgement."""
    if settings.plain:
        return None
    return max(settings.send_buffer, len(lay_out(ring.channels, settings).readings) * UPDATE_SIZE)


async def serve(
    ring: SimulatedRing,
    settings: SimSettings,
    announce: Announce,
    stop: asyncio.Event,
) -> None:
    """Serve a ring over Channel Access, and arrays that are named so over pvAccess, until stopped.

    Args:
        ring: The simulated ring.
        settings: Where and how.
        announce: Called once clients can connect.
        stop: Ends it when set.

    Raises:
        OwnershipError: Somebody else has the port.
    """
    sockets = claim(settings.interface, settings.port, send_buffer(ring, settings))
    try:
        server = RingServer(ring, settings)
        context, pva = server.front.context(sockets), server.front.pva
        searched = 0 if pva is None else pva.start(settings.interface, settings.pva_port)
        server.start()
        ready = asyncio.Event()

        async def note_startup(_library: object) -> None:
            ready.set()

        running = asyncio.create_task(context.run(startup_hook=note_startup))
        waiting = [asyncio.create_task(ready.wait()), asyncio.create_task(stop.wait())]
        try:
            await asyncio.wait([running, waiting[0]], return_when=asyncio.FIRST_COMPLETED)
            if ready.is_set():
                announce(Served(sockets.port, len(server.layout), searched))
            ends = [running, waiting[1], server.failed]
            await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
        finally:
            server.stop()
            if pva is not None:
                pva.stop()
            for task in (*waiting, running):
                task.cancel()
            await asyncio.wait([*waiting, running], timeout=_PATIENCE)
        for end in (running, server.failed):
            if end.done() and not end.cancelled() and (failure := end.exception()):
                raise failure
    finally:
        sockets.close()
