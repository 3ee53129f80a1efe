"""How many messages the loop costs a server that serves every kind of subscription alike."""

import asyncio
import threading
import time
from collections import Counter
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from caproto.asyncio.server import VirtualCircuit

from orbitfb.core.clock import SystemClock
from orbitfb.core.signals import Channels, LoopState
from orbitfb.epics.machine import EpicsMachine
from orbitfb.epics.settings import EpicsSettings
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings
from orbitfb.sim.access.context import ClaimedContext
from orbitfb.sim.served import Served
from orbitfb.sim.server import serve
from orbitfb.sim.settings import SimSettings

pytestmark = [pytest.mark.system, pytest.mark.timing]  # it counts messages by ticks

SIZE, RATE_HZ, TICKS = 6, 20.0, 10
WINDOWS = 60
"""Times that so many ticks are looked at, at most."""
DEVICES = [f"M:{number}" for number in range(SIZE)]
CHANNELS = Channels(
    planes="x",
    bpms=tuple(f"B{name}" for name in DEVICES),
    correctors=tuple(f"C{name}" for name in DEVICES),
    orbit_pvs=tuple(f"B{name}:X" for name in DEVICES),
    setpoint_pvs=tuple(f"C{name}:SP" for name in DEVICES),
    readback_pvs=tuple(f"C{name}:RB" for name in DEVICES),
)


class StillRing:
    """A ring that nothing moves: its orbit is noise of 1 µm."""

    channels = CHANNELS

    def __init__(self) -> None:
        self.tick = 0
        self._noise = np.random.default_rng(1)

    def step(self, setpoints: np.ndarray, frequency_change: float = 0.0) -> SimpleNamespace:
        self.tick += 1
        orbit = self._noise.normal(0.0, 1e-6, SIZE)
        return SimpleNamespace(reading=orbit, true_orbit=orbit, readback=setpoints.copy())


@dataclass(frozen=True, slots=True)
class Wander:
    """A law that moves every corrector at every tick."""

    policy_id: str = "wander"

    def initial_state(self) -> int:
        return 0

    def act(self, error: np.ndarray, valid: np.ndarray, state: int) -> tuple[np.ndarray, int]:
        return np.full(SIZE, 1e-3 if state % 2 else -1e-3), state + 1


class Server:
    """The ring behind caproto's documented calls, on an event loop of its own."""

    def __init__(self) -> None:
        self.ready = threading.Event()
        self.port = 0

    def run(self, ring: StillRing) -> None:
        asyncio.run(self._serve(ring))

    def end(self) -> None:
        self._loop.call_soon_threadsafe(self._stop.set)

    async def _serve(self, ring: StillRing) -> None:
        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        settings = SimSettings(port=0, rate_hz=RATE_HZ, plain=True)
        await serve(ring, settings, self._announce, self._stop)

    def _announce(self, served: Served) -> None:
        self.port = served.port
        self.ready.set()


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """What the server has sent, by kind of message."""
    sent: Counter[str] = Counter()

    class CountingCircuit(VirtualCircuit):
        async def send(self, *commands: object) -> None:
            sent.update(type(command).__name__ for command in commands)
            await super().send(*commands)

    monkeypatch.setattr(ClaimedContext, "CircuitClass", CountingCircuit)
    return sent


def test_a_tick_costs_caproto_one_event_of_each_pv_and_nothing_else(answers: Counter[str]):
    """caproto 1.3 sends events of units and limits with every value, if asked for them."""
    ring, background = StillRing(), Server()
    server = threading.Thread(target=background.run, args=(ring,))
    server.start()
    try:
        assert background.ready.wait(60.0)
        watch_loop(background.port, ring, answers)
    finally:
        background.end()
        server.join()


def watch_loop(port: int, ring: StillRing, answers: Counter[str]) -> None:
    """Close the loop; see that some ticks on end cost what they must and no more."""
    epics = EpicsSettings(server_port=port, connect_timeout=20.0, reconnect_period=0.2)
    slow, events = len(epics.auxiliary), "EventAddResponse"
    expected = 3 * SIZE + slow
    over = threading.Event()
    with EpicsMachine(CHANNELS, epics) as machine:
        runner = Runner(
            machine,
            PolicySlot(Wander()),
            LoopSettings(rate_hz=RATE_HZ),
            LimitSettings(),
            InterlockSettings(),
            np.zeros(SIZE),
            SystemClock(),
            start=LoopState.CLOSED,
        )
        thread = threading.Thread(target=runner.run, args=(over,))
        thread.start()
        try:
            for _ in range(WINDOWS):
                tick, before = ring.tick, answers.copy()
                while ring.tick < tick + TICKS:
                    time.sleep(0.25 / RATE_HZ)
                sent, ticks = answers - before, ring.tick - tick
                # The first or the last tick may be under way. A busy computer sends later, and in
                # another window: it is waited for one in which it keeps up.
                told = 2 * SIZE * (ticks - 1) <= sent[events] <= expected * (ticks + 1)
                if set(sent) == {events} and told and runner.state is LoopState.CLOSED:
                    return
        finally:
            over.set()
            thread.join()
    raise AssertionError(
        f"{ticks} ticks with {dict(sent)}: {expected} events each are needed; "
        f"{runner.state}: {runner.reason}"
    )
