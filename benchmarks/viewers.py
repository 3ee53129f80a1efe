"""Measure what viewers of the operator page cost the loop: `python -m benchmarks.viewers`.

A service runs against its simulated ring; viewers come and go in turns, so that every minute of
the computer hits all kinds of company alike. A stalled viewer opens the page and reads nothing.
In the same run, a service whose page is served from a thread of its own process: what was decided
against. Services alternate as their viewers do.
"""

import argparse
import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.circumstances import circumstances, load
from benchmarks.measure import Samples, cpu_time
from orbitfb.control.client import ask
from orbitfb.history.archive import read_archive

KINDS: dict[str, tuple[int, int]] = {
    "no viewer": (0, 0),
    "1 viewer": (1, 0),
    "10 viewers": (10, 0),
    "1 viewer that stalls": (0, 1),
}
"""Viewers that read, and viewers that stall, by kind."""
SETTLE = 1.0
"""Left out at both ends of a turn [s]."""
PLACES = {"process": "orbitfb", "thread": "benchmarks.page_in_thread"}
"""The program that runs, by where it serves the page from."""
ORDER = ("process", "thread", "thread", "process")
VIEWER = """
import os, sys, websockets.sync.client as client
os.nice(19)  # browsers run on other computers
viewers = [client.connect(sys.argv[1], compression=None) for _ in range(int(sys.argv[2]))]
print("looking", flush=True)
while True:
    for viewer in viewers:
        viewer.recv()
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="JSON file to write")
    parser.add_argument("--rate", type=float, default=20.0, help="of the loop [Hz]")
    parser.add_argument("--turns", type=int, default=4, help="of every kind of company")
    parser.add_argument("--seconds", type=float, default=12.0, help="of a turn")
    options = parser.parse_args()
    before = load()
    every: dict[str, dict[str, list[Company]]] = {place: defaultdict(list) for place in PLACES}
    for place in ORDER:
        found = measure(PLACES[place], options.rate, options.turns, options.seconds)
        for kind, its in found.items():
            every[place][kind].append(its)
    command = " ".join(["python -m benchmarks.viewers", *sys.argv[1:]])
    about = {**circumstances(command, ORDER.count("process"), False), "load_before": before}
    about["load_after"] = load()
    result: dict[str, Any] = {"about": about, "rate_hz": options.rate, "seconds": options.seconds}
    for place, kinds in every.items():
        result[place] = {kind: summary(its) for kind, its in kinds.items()}
        for kind, row in result[place].items():
            print(f"{place}, {kind}: {json.dumps(row)}")
    if options.out:
        options.out.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


@dataclass(frozen=True, slots=True)
class Company:
    """What one kind of company cost in one run.

    Args:
        latency: From the stamp of an orbit to the last setpoint sent, every tick [s].
        cpu: CPU time of the loop's process, all threads, in a second [s].
    """

    latency: Samples
    cpu: float


def measure(module: str, rate: float, turns: int, seconds: float) -> dict[str, Company]:
    """Run a service, let viewers come and go, and take the latencies from its archive.

    Args:
        module: Which program runs.
        rate: Of the loop [Hz].
        turns: Of every kind of company.
        seconds: Of a turn [s].

    Returns:
        By kind of company.
    """
    spans: dict[str, list[tuple[float, float]]] = {name: [] for name in KINDS}
    cpu: dict[str, list[float]] = {name: [] for name in KINDS}
    with tempfile.TemporaryDirectory() as name, serving(Path(name), rate, module) as its:
        pid, page = its
        time.sleep(5.0)  # until the loop has settled
        for turn in range(turns):
            names = list(KINDS)
            for kind in names[turn % len(names) :] + names[: turn % len(names)]:
                with company(page, *KINDS[kind]):
                    begin, used = time.time(), cpu_time(pid)
                    time.sleep(seconds)
                    cpu[kind].append((cpu_time(pid) - used) / (time.time() - begin))
                    spans[kind].append((begin + SETTLE, time.time() - SETTLE))
                time.sleep(SETTLE)
        ask(Path(name) / "data", {"command": "open"})
        time.sleep(2.0)  # until the archive has written it
        rows = read_archive(Path(name) / "data" / "archive")
    latency = rows.written - rows.time
    found: dict[str, Company] = {}
    for kind, its in spans.items():
        inside = np.zeros(len(latency), dtype=np.bool_)
        for begin, end in its:
            inside |= (rows.time >= begin) & (rows.time < end)
        found[kind] = Company(latency[inside & np.isfinite(latency)], float(np.mean(cpu[kind])))
    return found


@contextlib.contextmanager
def serving(directory: Path, rate: float, module: str) -> Generator[tuple[int, str], None, None]:
    """Run a service without a learner; give its number and the address of its page."""
    config = directory / "config.toml"
    config.write_text(
        "[web]\nport = 0\nviewers = 20\n[learn]\nenabled = false\n"
        "[diagnose.live]\nenabled = false\n[observe.terminal]\nmode = 'off'\n"
    )
    words = [
        *(sys.executable, "-m", module, "run", "--ioc", "sim", "--port", "0"),
        *("--metrics-port", "0", "--data", str(directory / "data")),
        *("--config", str(config), "--rate", str(rate)),
    ]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, text=True, env=environment, start_new_session=True
    ) as process:
        try:
            yield process.pid, _address(process)
        finally:
            process.terminate()
            process.wait(20)


def _address(process: subprocess.Popen[str]) -> str:
    lines: list[str] = []
    if process.stdout is not None:
        for line in process.stdout:
            lines.append(line)
            if line.startswith("operator page on "):
                return line.split()[-1]
    raise RuntimeError(f"no page: {''.join(lines)}")


@contextlib.contextmanager
def company(page: str, looking: int, stalled: int) -> Generator[None, None, None]:
    """Let viewers look, in a process of their own, and others stall."""
    with contextlib.ExitStack() as stack:
        for _ in range(stalled):
            stack.enter_context(stall(page))
        if looking:
            where = page.replace("http://", "ws://") + "live"
            words = [sys.executable, "-c", VIEWER, where, str(looking)]
            process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
            stack.callback(process.wait)
            stack.callback(process.kill)
            if process.stdout is None or process.stdout.readline() != b"looking\n":
                raise RuntimeError("the viewers could not look")
        yield


def stall(page: str) -> socket.socket:
    """Open the live picture as a browser does, take 100 bytes, and read nothing more."""
    host, port = page.removeprefix("http://").rstrip("/").rsplit(":", 1)
    viewer = socket.socket()
    viewer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    viewer.connect((host, int(port)))
    viewer.sendall(
        f"GET /live HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
    )
    viewer.recv(100)
    return viewer


def summary(runs: Sequence[Company]) -> dict[str, Any]:
    """Sum up all runs in ms; p99 of every run besides, to see how they scatter."""
    every = np.concatenate([run.latency for run in runs]) * 1e3
    p50, p99 = np.percentile(every, [50, 99])
    return {
        "ticks": len(every),
        "p50_ms": round(float(p50), 2),
        "p99_ms": round(float(p99), 2),
        "max_ms": round(float(every.max()), 2),
        "p99_ms_of_runs": [round(1e3 * float(np.percentile(run.latency, 99)), 2) for run in runs],
        "cpu_ms_per_s": round(1e3 * float(np.mean([run.cpu for run in runs])), 2),
    }


if __name__ == "__main__":
    main()
