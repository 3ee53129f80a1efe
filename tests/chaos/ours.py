"""The service under test, and the operator who watches it."""

import json
import os
import resource
import signal
import time
from pathlib import Path
from typing import Any

import psutil

from orbitfb.control.client import ask
from orbitfb.core.errors import ArchiveError, ControlError
from orbitfb.history.archive import read_archive
from orbitfb.history.reader import segment_paths
from orbitfb.loop.inquiry import WAITS
from orbitfb.safety.bpms import LATCHED
from tests.chaos.judge import LATE_TICKS
from tests.chaos.rings import LIMIT, STEP, Ring, Side, wait
from tests.chaos.second import Second

CONFIG = """
[loop]
rate_hz = {rate}
ramp = {ramp}
trip_after = 20.0
[limits]
setpoint = {limit}
change_per_tick = {step}
[interlocks]
readback_tolerance = 0.05
[learn]
every = 500
check = 100
minimum_rows = 200
[diagnose.live]
period = 20.0
[history]
capacity = 2000
[history.archive]
segment_megabytes = 20.0
[postmortem]
before = 1.0
after = 0.2
[web]
port = 0
[lease]
time = 1.0
required = true
[epics]
stale_after = {stale}
address_list = "{ports}"
connect_timeout = 60.0
reconnect_period = 0.5
[epics.auxiliary.current]
pv = "SR:C03-BI{{DCCT:1}}I:Real-I"
scale = 1e-3
stale_after = 0.3
"""
MODES = {"nan": "n", "raise": "r", "late": "l", "huge": "h", "shape": "s"}


class Ours:
    """`orbitfb run` on a ring, with commands and figures.

    Args:
        directory: For its data and what it prints.
        ring: Its ring.
        other: Another server, where it also looks for PVs.
        rate: Of the loop [Hz].
    """

    def __init__(self, directory: Path, ring: Ring, other: Ring, rate: float) -> None:
        self.data = directory / "data"
        directory.mkdir(parents=True)
        config, self._mode = directory / "c.toml", directory / "mode"
        ports = f"127.0.0.1:{ring.port} 127.0.0.1:{other.port}"
        text = CONFIG.format(
            rate=rate, ramp=3.0 / rate, stale=LATE_TICKS / rate, limit=LIMIT, step=STEP, ports=ports
        )
        config.write_text(text)
        self._mode.write_text(".")
        command = ["-m", "tests.chaos.controller", self._mode, "run", "--config", config]
        command += ["--ioc", "config", "--data", self.data]
        command += ["--metrics-port", 0, "--start", "closed"]
        self.unlogged: list[tuple[float, float]] = []
        self.side = Side([str(word) for word in command], directory, ring.port)
        self.second = Second(command, directory / "second", ring.port)

    def status(self) -> dict[str, Any] | None:
        """Ask how it is; None: it does not answer."""
        try:
            return ask(self.data, {"command": "status"}, timeout=5.0)
        except ControlError:
            return None

    def is_well(self) -> bool:
        """Whether it is CLOSED and has nothing to say."""
        status = self.status()
        return bool(status and status["state"] == "CLOSED" and not status["reason"])

    def command(self, name: str) -> str:
        """Give a command; says why it was refused, if so."""
        try:
            ask(self.data, {"command": name}, timeout=5.0)
        except ControlError as error:
            return str(error)
        return ""

    def mode(self, mode: str) -> None:
        """Let the policy misbehave; empty: no more."""
        with self._mode.open("r+") as file:
            file.write(MODES.get(mode, "."))

    def events(self, name: str) -> list[dict[str, Any]]:
        """Lines of the log about one event."""
        lines: list[dict[str, Any]] = []
        for file in sorted(self.data.glob("orbitfb.log.jsonl*")):
            for line in file.read_text().splitlines():
                if f'"{name}"' in line:
                    entry = json.loads(line)
                    lines += [entry] if entry.get("event") == name else []
        return lines

    def postmortems(self) -> int:
        """How many there are."""
        return len(self.events("postmortem_written"))

    def fill_disk(self, full: bool) -> None:
        """Let no file grow beyond what it has, as a full disk does."""
        most = 4096 if full else resource.RLIM_INFINITY
        process = psutil.Process(self.side.popen.pid)
        _, hard = process.rlimit(psutil.RLIMIT_FSIZE)
        process.rlimit(psutil.RLIMIT_FSIZE, (most, hard))
        self._log_stops(full)

    def take_descriptors(self, taken: bool) -> None:
        """Let it open no file and take no connection beyond those that it has."""
        process = psutil.Process(self.side.popen.pid)
        _, hard = process.rlimit(psutil.RLIMIT_NOFILE)
        process.rlimit(psutil.RLIMIT_NOFILE, (process.num_fds() if taken else hard, hard))
        self._log_stops(taken)

    def _log_stops(self, begins: bool) -> None:
        """Remember when the log cannot say what happened."""
        if begins:
            self.unlogged.append((time.time() - 0.5, float("inf")))
        else:
            self.unlogged[-1] = self.unlogged[-1][0], time.time() + 0.5

    def kill(self) -> None:
        """kill -9; what the last seconds were it cannot say any more."""
        self.unlogged.append((time.time() - 2.0, time.time() + 0.5))
        self.side.kill()

    def hide_archive(self, hidden: bool) -> None:
        """Take the directory of the archive away, or bring it back."""
        here, there = self.data / "archive", self.data / "archive-away"
        if hidden and here.exists():
            os.rename(here, there)
        elif not hidden and there.exists():
            here.mkdir(exist_ok=True)
            for file in there.iterdir():
                if not (here / file.name).exists():
                    os.rename(file, here / file.name)

    def read_archive(self) -> str:
        """Read the end of the archive while it is written; says what cannot be read."""
        return self._read(self.data / "archive", 50)

    def read_all(self) -> list[str]:
        """Read every segment of the archive; says what cannot be read."""
        return [
            f"{path.name}: {problem}"
            for path in segment_paths(self.data / "archive")
            if (problem := self._read(path, None)) and "no readable row" not in problem
        ]

    @staticmethod
    def _read(path: Path, last: int | None) -> str:
        try:
            read_archive(path, last=last)
        except (ArchiveError, OSError) as error:
            return f"{type(error).__name__}: {error}"
        return ""

    def hang_up(self, timeout: float = 10.0) -> bool:
        """Close its terminal; says whether it ended as when it is told to stop."""
        before = len(self.events("service_stopped"))
        self.side.signal(signal.SIGHUP)
        wait(lambda: not self.side.alive, timeout)
        return not self.side.alive and len(self.events("service_stopped")) > before

    def close(self, timeout: float = 10.0) -> None:
        """Stop it as its user does."""
        self.second.end()
        if self.side.alive:
            self.side.signal(signal.SIGCONT)
            self.side.signal(signal.SIGINT)
            wait(lambda: not self.side.alive, timeout)
        self.side.kill()

    def come_up(self, timeout: float = 120.0) -> bool:
        """Wait until it is well after a start."""
        return wait(lambda: not self.side.alive or self.is_well(), timeout, 0.2) and self.side.alive


def needs_hand(state: str, reason: str) -> bool:
    """Say whether only an operator helps, who opens and closes; a loop that asks is let alone."""
    if state == "CLOSED":
        return WAITS not in reason
    return LATCHED in reason or "another server than before" in reason
