"""The processes of a campaign: a ring, the service at it, the plain loop at its twin."""

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from orbitfb.sim.environment import client_environment
from tests.free_ports import free_port

LIMIT, STEP, DRIVE = 1.0, 0.2, 1.2
"""Limits [A] of the loop's setpoints and steps, and of the IOC: near what this ring needs."""


class LostError(Exception):
    """A process of the harness did not do what it must."""


class Ring:
    """A soft IOC with faults; it may be killed and started again at its port.

    Args:
        directory: Where job and journal lie.
        seed: Of its random numbers.
        rate: Of its orbits [Hz].
    """

    def __init__(self, directory: Path, seed: int, rate: float) -> None:
        directory.mkdir(parents=True)
        self._directory, self._seed, self._rate = directory, seed, rate
        self.journal = directory / "journal.bin"
        self.port, self.life = free_port(), 0  # the kernel must not give it away while it is down
        self.faults: list[dict[str, Any]] = []
        self.start()

    def start(self, drive: float = DRIVE) -> None:
        """Start, and tell it the faults that are on."""
        sim = {"port": self.port, "rate_hz": self._rate, "corrector_limit": drive}
        job = self._directory / "job.json"
        job.write_text(json.dumps({"seed": self._seed, "sim": sim}))
        arguments = [str(job), str(self.journal), str(self.life), str(LIMIT), str(STEP)]
        with (self._directory / f"ioc.{self.life}.err").open("w") as err:
            self._popen = subprocess.Popen(
                [sys.executable, "-m", "tests.chaos.ioc", *arguments],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=err,
                text=True,
                start_new_session=True,
            )
        self.life += 1
        self._lines: queue.Queue[str] = queue.Queue()
        threading.Thread(target=self._listen, args=(self._popen,), daemon=True).start()
        self.port = int(self._answer(30.0))
        self.tell(faults=self.faults)

    def _listen(self, popen: "subprocess.Popen[str]") -> None:
        assert popen.stdout is not None
        lines = self._lines
        for line in popen.stdout:
            lines.put(line)
        lines.put("")

    def _answer(self, timeout: float = 10.0) -> str:
        try:
            line = self._lines.get(timeout=timeout)
        except queue.Empty:
            raise LostError(f"the IOC in {self._directory} does not answer") from None
        if not line:
            raise LostError(f"the IOC in {self._directory} ended: see ioc.{self.life - 1}.err")
        return line

    def tell(self, **what: Any) -> dict[str, Any]:
        """Tell it something; gives tick, rms and peak of the true orbit [m]."""
        assert self._popen.stdin is not None
        try:
            self._popen.stdin.write(json.dumps(what) + "\n")
            self._popen.stdin.flush()
        except BrokenPipeError:
            raise LostError(f"the IOC in {self._directory} ended") from None
        return json.loads(self._answer())

    def kill(self) -> None:
        """kill -9."""
        self._popen.kill()
        self._close()

    def signal(self, number: int) -> None:
        self._popen.send_signal(number)

    def close(self) -> None:
        """End it."""
        with contextlib.suppress(ProcessLookupError):
            self._popen.send_signal(signal.SIGCONT)
        self._popen.kill()
        self._close()

    def _close(self) -> None:
        self._popen.wait(10)
        for stream in (self._popen.stdin, self._popen.stdout):
            with contextlib.suppress(OSError):
                stream.close() if stream else None


class Side:
    """A controller's process.

    Args:
        command: What follows the interpreter.
        directory: Where it may print.
        port: Of its ring.
        environment: Besides.
    """

    def __init__(
        self,
        command: list[str],
        directory: Path,
        port: int,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._command, self._directory = command, directory
        self._environment = os.environ | client_environment(port) | dict(environment or {})
        self.starts = 0
        self.start()

    def start(self) -> None:
        """Start it anew."""
        with (
            (self._directory / f"{self.starts}.out").open("w") as out,
            (self._directory / f"{self.starts}.err").open("w") as err,
        ):
            self.popen = subprocess.Popen(
                [sys.executable, *self._command],
                stdout=out,
                stderr=err,
                env=self._environment,
                start_new_session=True,
            )
        self.starts += 1

    @property
    def alive(self) -> bool:
        return self.popen.poll() is None

    def signal(self, number: int) -> None:
        with contextlib.suppress(ProcessLookupError):
            self.popen.send_signal(number)

    def kill(self) -> None:
        """kill -9, it and its children."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.popen.pid, signal.SIGKILL)
        self.popen.wait(10)

    def output(self) -> str:
        return (self._directory / f"{self.starts - 1}.out").read_text()

    def errors(self) -> str:
        return (self._directory / f"{self.starts - 1}.err").read_text()


def wait(look: Any, timeout: float, poll: float = 0.05) -> bool:
    """Look until it is so, or time is over; says which."""
    deadline = time.monotonic() + timeout
    while not look():
        if time.monotonic() > deadline:
            return False
        time.sleep(poll)
    return True
