"""Clients of the panel that flood, stall or announce too much are dropped; nobody else notices."""

import asyncio
import contextlib
import logging
import socket
import struct
import threading
import time
from collections.abc import Iterator, Mapping
from typing import Any

import pytest

from orbitfb.core.bursts import ONE_BY_ONE
from orbitfb.panel import circuit
from orbitfb.panel.job import PanelJob
from orbitfb.panel.server import Panel
from orbitfb.panel.settings import PanelSettings
from orbitfb.sim.access.listening import claim

pytestmark = pytest.mark.system

PREFIX = "TST:FB{Orbit}"
HELLO = struct.pack(">HHHHII", 0, 0, 1, 13, 0, 0)


def named(command: int, text: str, first: int = 0, second: int = 0) -> bytes:
    padded = text.encode() + b"\0" * (8 - len(text) % 8)
    return struct.pack(">HHHHII", command, len(padded), 0, 0, first, second) + padded


class Serving:
    """A panel in a thread, with a service that notes what it is told."""

    def __init__(self, tmp_path: Any) -> None:
        logging.getLogger("caproto").setLevel(logging.CRITICAL)  # a traceback for every refusal
        self.told: list[Mapping[str, Any]] = []
        settings = PanelSettings(prefix=PREFIX, port=0, interface="127.0.0.1", period=0.05)
        job = PanelJob(data_directory=tmp_path, panel=settings, planes="x", bpms=4, correctors=4)
        self._job, self._sockets = job, claim("127.0.0.1", 0, 1 << 17, "panel")
        self.port = self._sockets.port
        self._ready, self._stop = threading.Event(), asyncio.Event()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_until_complete, args=(self._run(),))
        self._thread.start()
        assert self._ready.wait(30.0)

    def ask(self, request: Mapping[str, Any], timeout: float) -> Mapping[str, Any]:
        if request["command"] != "panel":
            self.told.append(request)
        return {"alive": True, "figures": {}}

    async def _run(self) -> None:
        panel = Panel(self._job, self.ask)
        self.context = panel.context(self._sockets)

        async def started(_: object) -> None:
            self._ready.set()

        tasks = [asyncio.create_task(self.context.run(startup_hook=started)),
                 asyncio.create_task(panel.keep_showing())]  # fmt: skip
        await self._stop.wait()
        for client in self.context.clients.all():
            client.hang_up()
        await asyncio.sleep(0.2)
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks, timeout=1.0)
        panel.close()
        self._sockets.close()

    def stop(self) -> None:
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(30.0)
        self._loop.close()

    def client(self) -> socket.socket:
        own = socket.create_connection(("127.0.0.1", self.port), 10.0)
        own.settimeout(10.0)
        own.sendall(HELLO)
        return own


@pytest.fixture
def panel(tmp_path: Any) -> Iterator[Serving]:
    serving = Serving(tmp_path)
    yield serving
    serving.stop()


def channel(own: socket.socket) -> int:
    """Ask for a channel as a usual client does; give the number that the server has for it."""
    own.sendall(named(20, "somebody") + named(18, PREFIX + "State-I", 1, 13))
    answer = b""
    while len(answer) < 48:  # version, access rights, channel
        answer += own.recv(4096)
    heads = [struct.unpack(">HHHHII", answer[k : k + 16]) for k in range(0, 48, 16)]
    return next(head[5] for head in heads if head[0] == 18)


def is_served(panel: Serving) -> bool:
    """Whether a usual client gets a channel, at once."""
    with panel.client() as own:
        return channel(own) >= 0


def is_dropped(own: socket.socket) -> bool:
    try:
        while own.recv(1 << 16):
            pass
    except ConnectionError:
        return True
    except TimeoutError:
        return False
    return True


def reasons(panel: Serving) -> str:
    end = time.monotonic() + 10.0
    while not panel.told and time.monotonic() < end:
        time.sleep(0.02)
    return " | ".join(str(each["reason"]) for each in panel.told)


def test_who_announces_four_gigabytes_is_dropped_and_named(panel: Serving):
    with panel.client() as own:
        own.sendall(named(20, "x\n\x1b[2Jforged"))
        own.sendall(struct.pack(">HHHHIIII", 4, 0xFFFF, 6, 0, 0, 0, 0xFFFFFFF0, 0x1FFFFFFF))
        assert is_dropped(own)
    assert "hung up on: a message of 4294967280 bytes was announced" in reasons(panel)
    assert panel.told[0]["origin"]["user"].isprintable()
    assert is_served(panel)


def test_who_floods_is_dropped_and_told_once(panel: Serving):
    with panel.client() as own:
        put = struct.pack(">HHHHII", 4, 8, 6, 1, channel(own), 0) + b"\0" * 8
        with contextlib.suppress(ConnectionError):
            own.sendall(put * 5000)
        assert is_dropped(own)
    assert "writes at once" in reasons(panel)
    assert len(panel.told) <= ONE_BY_ONE + 1
    assert is_served(panel)


def test_who_breaks_the_protocol_is_dropped(panel: Serving):
    with panel.client() as own:
        own.sendall(struct.pack(">HHHHII", 4, 8, 6, 1, 77, 0) + b"\0" * 8)
        assert is_dropped(own)
    assert is_served(panel)


def test_who_opens_many_connections_loses_his_own(panel: Serving):
    many = [panel.client() for _ in range(circuit.MOST_CLIENTS + 5)]
    try:
        assert is_dropped(many[0])
        assert is_served(panel)
        assert len(panel.context.clients) <= circuit.MOST_CLIENTS
    finally:
        for own in many:
            own.close()


def test_who_asks_for_nothing_is_dropped(tmp_path: Any, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(circuit, "PATIENCE", 1.0)
    panel = Serving(tmp_path)
    try:
        with panel.client() as own:
            assert is_dropped(own)
        assert is_served(panel)
    finally:
        panel.stop()


def test_who_takes_nothing_keeps_nobody_waiting(panel: Serving):
    with panel.client() as own:
        own.sendall(b"".join(named(18, PREFIX + "State-I", k, 13) for k in range(500)))
        assert is_served(panel)
