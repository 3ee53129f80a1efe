"""The servers: ours, ours by caproto's documented calls alone, EPICS base; and with arrays, over
Channel Access or pvAccess."""

import atexit
import os
import selectors
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

from benchmarks.array_places import array_places
from orbitfb.core.names import PVA
from orbitfb.sim.access.pva import server_keys
from orbitfb.sim.job import SimJob
from orbitfb.sim.settings import SimSettings

Server = Literal["ours", "plain", "base", "ours-arrays", "base-arrays", "ours-pva", "base-pva"]
ARRAYS, OVER_PVA = "-arrays", "-pva"
"""Of servers whose orbit, setpoints and readbacks are one PV each."""
LOCKSTEP_PATIENCE = 0.3
"""After so long without a set of setpoints a ring in lockstep ticks by itself [s]."""


@dataclass(frozen=True, slots=True)
class Running:
    """A server that serves: its process, its Channel Access port, and that of pvAccess or 0."""

    pid: int
    port: int
    pva_port: int


def job_of(server: Server, rate_hz: float | None, seed: int) -> SimJob:
    """Say what a server serves; no rate means lockstep."""
    return SimJob(
        places=_array_table(PVA if server.endswith(OVER_PVA) else "")
        if server.endswith((ARRAYS, OVER_PVA))
        else None,
        seed=seed,
        sim=SimSettings(
            port=0,
            pva_port=0,
            rate_hz=rate_hz or 1.0 / LOCKSTEP_PATIENCE,
            lockstep=rate_hz is None,
            plain=server == "plain",
        ),
    )


@cache
def _array_table(over: str) -> Path:
    folder = TemporaryDirectory()
    atexit.register(folder.cleanup)
    return array_places(Path(folder.name, "places.csv"), over)


@contextmanager
def serving(server: Server, job: SimJob, size: int | None = None) -> Generator[Running, None, None]:
    """Run a server in a process of its own.

    Args:
        server: Which.
        job: What it serves.
        size: A counting ring of so many BPMs and correctors instead of the job's ring.
    """
    base = server.startswith("base")
    port, pva_port = (_free_port(), _free_port()) if base else (0, 0)
    if base:
        command = ["-m", "benchmarks.base_ioc", str(port), str(size or 0)]
    elif size is not None:
        command = ["-m", "benchmarks.counting_ioc", str(size)]
    else:
        command = ["-m", "orbitfb.sim"]
    words = tempfile.TemporaryFile()  # noqa: SIM115
    process = subprocess.Popen(
        [sys.executable, *command],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=words,
        env=os.environ | _base_environment(port, pva_port),
    )
    try:
        said = _start(process, job)
        told = dict(part.split("=") for part in said.split() if "=" in part)
        yield Running(process.pid, int(told["port"]), int(told.get("pva", pva_port)))
    finally:
        if process.poll() is not None:
            words.seek(0)
            sys.stderr.write(f"the server ({server}) ended by itself: {words.read().decode()}\n")
        process.kill()
        process.wait()
        for pipe in (process.stdin, process.stdout, words):
            if pipe is not None:
                pipe.close()


def _start(process: subprocess.Popen[bytes], job: SimJob, timeout: float = 60.0) -> str:
    if process.stdin is None or process.stdout is None:
        raise RuntimeError("a server was started without its pipes")
    process.stdin.write(job.model_dump_json().encode() + b"\n")
    process.stdin.flush()
    said, deadline = b"", time.monotonic() + timeout
    with selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ)
        while not (b"READY port=" in said and said.endswith(b"\n")):
            left = deadline - time.monotonic()
            piece = os.read(process.stdout.fileno(), 4096) if selector.select(left) else b""
            if not piece:
                raise RuntimeError(f"the server did not start: {said.decode()}")
            said += piece
    return said.decode()


def _base_environment(port: int, pva_port: int) -> dict[str, str]:
    if not port:
        return {}
    return {
        "EPICS_CAS_SERVER_PORT": str(port),
        "EPICS_CAS_INTF_ADDR_LIST": "127.0.0.1",
        "EPICS_CAS_AUTO_BEACON_ADDR_LIST": "NO",
        "EPICS_CAS_BEACON_ADDR_LIST": "127.0.0.1",
        "EPICS_CAS_BEACON_PORT": str(_free_port()),
        "EPICS_CA_ADDR_LIST": "127.0.0.1",
        "EPICS_CA_AUTO_ADDR_LIST": "NO",
        **server_keys("127.0.0.1", pva_port),
    }


def _free_port() -> int:
    from orbitfb.sim.access.listening import claim

    sockets = claim("127.0.0.1", 0)
    sockets.close()
    return sockets.port
