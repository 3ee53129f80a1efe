"""A Channel Access client of bare sockets, and clients in processes of their own."""

import contextlib
import json
import os
import signal
import socket
import struct
import subprocess
import tempfile
import textwrap
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from forked import Forked, finish, start

from orbitfb.physics.places import Ring
from orbitfb.sim.child import SimChild
from orbitfb.sim.environment import client_environment
from orbitfb.sim.job import SimJob

CHANNELS = Ring.load().channels("x")
TICK, RMS = "SR:SIM{Ring}Tick-I", "SR:SIM{Ring}Rms:True-I"
CURRENT, KICK, RF = "SR:C03-BI{DCCT:1}I:Real-I", "SR:SIM{Ring}Kick-SP", "RF{Osc:1}Freq:I"
READINGS = (*CHANNELS.readback_pvs, *CHANNELS.orbit_pvs, CURRENT, RF, RMS, TICK)
DOUBLE, TIME_DOUBLE, CONTROL_DOUBLE = 6, 20, 34
_HEADER = struct.Struct(">HHHHII")


@contextlib.contextmanager
def serving(**sim: Any) -> Iterator[SimChild]:
    """A soft IOC of the default ring on a free port."""
    with SimChild(SimJob.model_validate({"seed": 7, "sim": {"port": 0} | sim})) as child:
        yield child


@dataclass(frozen=True)
class QuickRing:
    """A soft IOC that was forked.

    Args:
        process: Serves it.
        port: Its port.
    """

    process: "subprocess.Popen[bytes] | Forked"
    port: int

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self.process.poll() is None


@contextlib.contextmanager
def quick_ring(**sim: Any) -> Iterator[QuickRing]:
    """The same without the second in which a new process imports what it needs."""
    job = SimJob.model_validate({"seed": 7, "sim": {"port": 0} | sim})
    script = f"""
from orbitfb.sim.job import SimJob
from orbitfb.sim.process import run_job
job = SimJob.model_validate_json({job.model_dump_json()!r})
run_job(job, lambda served: print(served.port, flush=True))
"""
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        process = start([], out, err, os.environ, script)
        try:
            while not (told := os.pread(out.fileno(), 99, 0)).endswith(b"\n"):
                assert process.poll() is None, os.pread(err.fileno(), 9999, 0).decode()
                time.sleep(0.01)
            yield QuickRing(process, int(told))
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(60.0)


def run_client(port: int, script: str) -> Any:
    """Run a script as a client and give the JSON that it prints last."""
    environment = os.environ | client_environment(port)
    done = finish([], environment, 180.0, textwrap.dedent(script))
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@dataclass(frozen=True)
class Event:
    """One monitor update as it came over the wire."""

    name: str
    value: float
    status: int
    severity: int
    stamp: tuple[int, int]


@dataclass(frozen=True)
class Message:
    """Any message."""

    command: int
    data_type: int
    count: int
    first: int
    second: int
    payload: bytes


class RawClient:
    """Speaks the protocol by hand, so that order and bytes can be checked."""

    def __init__(self, port: int, receive_buffer: int | None = None) -> None:
        self.socket = socket.socket()
        if receive_buffer:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        self.socket.settimeout(60)
        self.socket.connect(("127.0.0.1", port))
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._data = b""
        self.sid: dict[str, int] = {}
        self.rights: dict[str, int] = {}
        self._subscribed: dict[int, str] = {}
        name = b"tester\0\0"
        self.send((0, b"", 0, 13, 0, 0), (20, name, 0, 0, 0, 0), (21, name, 0, 0, 0, 0))

    def __enter__(self) -> "RawClient":
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def send(self, *messages: tuple[int, bytes, int, int, int, int]) -> None:
        self.socket.sendall(
            b"".join(
                _HEADER.pack(command, len(payload), data_type, count, first, second) + payload
                for command, payload, data_type, count, first, second in messages
            )
        )

    def receive(self) -> Message:
        while True:
            if len(self._data) >= 16:
                command, size, data_type, count, first, second = _HEADER.unpack(self._data[:16])
                if len(self._data) >= 16 + size:
                    payload, self._data = self._data[16 : 16 + size], self._data[16 + size :]
                    return Message(command, data_type, count, first, second, payload)
            piece = self.socket.recv(65536)
            if not piece:
                raise ConnectionResetError("the server closed the connection")
            self._data += piece

    def create(self, *names: str) -> None:
        base = len(self.sid)
        self.send(*((18, _pad(name), 0, 0, base + row, 13) for row, name in enumerate(names)))
        left = len(names)
        while left:
            message = self.receive()
            if message.command in (18, 22):
                name = names[message.first - base]
                if message.command == 22:
                    self.rights[name] = message.second
                else:
                    self.sid[name] = message.second
                    left -= 1
            else:
                assert message.command == 0, message

    def subscribe(self, *names: str, data_type: int = TIME_DOUBLE, mask: int = 5) -> None:
        mask_field = struct.pack(">3fHH", 0, 0, 0, mask, 0)
        for name in names:
            number = 1000 + len(self._subscribed)
            self._subscribed[number] = name
            self.send((1, mask_field, data_type, 1, self.sid[name], number))

    def cancel(self, name: str) -> None:
        number = next(n for n, known in self._subscribed.items() if known == name)
        self.send((2, b"", TIME_DOUBLE, 1, self.sid[name], number))

    def put(self, values: dict[str, float]) -> None:
        self.send(
            *((4, struct.pack(">d", v), DOUBLE, 1, self.sid[n], 7) for n, v in values.items())
        )

    def put_waiting(self, name: str, value: float) -> Message:
        self.send((19, struct.pack(">d", value), DOUBLE, 1, self.sid[name], 9))
        while (message := self.receive()).command not in (19, 11):
            pass
        return message

    def get(self, name: str) -> Event:
        self.send((15, b"", TIME_DOUBLE, 1, self.sid[name], 8))
        while (message := self.receive()).command != 15:
            pass
        return _event(name, message)

    def event(self) -> Event:
        while (message := self.receive()).command != 1 or not message.payload:
            pass
        return _event(self._subscribed[message.second], message)

    def events(self, count: int) -> list[Event]:
        return [self.event() for _ in range(count)]

    def frame(self, last: str = TICK) -> list[Event]:
        """Everything up to and with the next update of the last PV of a tick."""
        frame = [self.event()]
        while frame[-1].name != last:
            frame.append(self.event())
        return frame


def _event(name: str, message: Message) -> Event:
    if message.data_type != TIME_DOUBLE:  # in every scalar double the value is last
        return Event(name, struct.unpack(">d", message.payload[-8:])[0], 0, 0, (0, 0))
    status, severity, seconds, nanoseconds, value = struct.unpack(">HHIIxxxxd", message.payload)
    return Event(name, value, status, severity, (seconds, nanoseconds))


def _pad(name: str) -> bytes:
    text = name.encode() + b"\0"
    return text + b"\0" * (-len(text) % 8)


def same(events: Sequence[Event]) -> bool:
    """Whether all carry one stamp."""
    return len({event.stamp for event in events}) == 1
