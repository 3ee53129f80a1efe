"""A Channel Access server as a child process that is never left behind; the soft IOC is one."""

import os
import re
import selectors
import signal
import subprocess
import sys
import tempfile
import time
from types import TracebackType
from typing import IO, Self

from orbitfb.core.errors import MachineError, OwnershipError
from orbitfb.core.settings import Settings
from orbitfb.sim.environment import client_environment
from orbitfb.sim.job import PORT_TAKEN, SimJob

_READY = re.compile(rb"^READY port=(\d+) pvs=(\d+)(?: pva=(\d+))?\n", re.MULTILINE)
_LAST_WORDS = 4000


class ServerChild:
    """Runs `python -m` a module that takes a job and says READY.

    The child has a process group of its own, so that Ctrl-C in a terminal reaches the parent
    alone, and it ends when the pipe to it closes, so that it cannot outlive the parent.

    Args:
        job: What to serve.
        module: Which to run.
        what: It is, in words.
    """

    def __init__(self, job: Settings, module: str, what: str) -> None:
        self._job, self._module, self._what = job, module, what
        self._process: subprocess.Popen[bytes] | None = None
        self._errors: IO[bytes] | None = None
        self._port: int | None = None
        self.pva_port = 0
        """Where searches over pvAccess come (UDP), once it is started; 0: it serves none."""

    @property
    def pid(self) -> int:
        """Process id.

        Raises:
            MachineError: It was never started.
        """
        return self._started.pid

    @property
    def port(self) -> int:
        """Channel Access port.

        Raises:
            MachineError: It was never started.
        """
        if self._port is None:
            raise MachineError(f"{self._what} has not been started; call start() first")
        return self._port

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process is not None and self._process.poll() is None

    def environment(self) -> dict[str, str]:
        """Give the environment variables with which a client finds it."""
        return client_environment(self.port)

    def start(self, timeout: float = 20.0) -> int:
        """Start it, again if it has died, and wait until it serves.

        Args:
            timeout: How long to wait [s].

        Returns:
            The Channel Access port.

        Raises:
            OwnershipError: It runs already, or somebody else has the port.
            MachineError: It ended, or was not ready in time; with what it said on standard error.
        """
        if self.alive:
            raise OwnershipError(f"{self._what} runs already, process {self.pid}; stop() it first")
        self._close()
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
        self._process = subprocess.Popen(
            [sys.executable, "-m", self._module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            start_new_session=True,
        )
        try:
            self._port = self._await_ready(self._process, timeout)
        except BaseException:
            self.stop(0.0)
            raise
        return self._port

    def stop(self, timeout: float = 2.0) -> None:
        """End it: politely, and by force when it has not gone after the timeout [s]."""
        process = self._process
        if process is not None and process.poll() is None:
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(timeout)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._close()

    def last_words(self) -> str:
        """Give the end of what it said on standard error."""
        if self._errors is None:
            return ""
        self._errors.seek(0, os.SEEK_END)
        self._errors.seek(max(0, self._errors.tell() - _LAST_WORDS))
        return self._errors.read().decode(errors="replace").strip()

    def __enter__(self) -> Self:
        """Start it."""
        self.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Stop it."""
        self.stop()

    @property
    def _started(self) -> subprocess.Popen[bytes]:
        if self._process is None:
            raise MachineError(f"{self._what} has not been started; call start() first")
        return self._process

    def _await_ready(self, process: subprocess.Popen[bytes], timeout: float) -> int:
        deadline = time.monotonic() + timeout
        if process.stdin is None or process.stdout is None:
            raise MachineError(f"{self._what} was started without its pipes")
        try:
            process.stdin.write(self._job.model_dump_json().encode() + b"\n")
            process.stdin.flush()
        except BrokenPipeError:
            pass  # it died at once; below its reason is told
        said = b""
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            while (found := _READY.search(said)) is None:
                if not selector.select(max(0.0, deadline - time.monotonic())):
                    raise MachineError(
                        f"{self._what} was not ready within {timeout:.1f} s; {self._reason()}"
                    )
                piece = os.read(process.stdout.fileno(), 4096)
                if not piece:
                    kind = OwnershipError if process.wait() == PORT_TAKEN else MachineError
                    raise kind(f"{self._what} did not start: {self._reason()}")
                said += piece
        self.pva_port = int(found.group(3) or 0)
        return int(found.group(1))

    def _reason(self) -> str:
        return self.last_words() or "it said nothing"

    def _close(self) -> None:
        process = self._process
        for pipe in (process.stdin, process.stdout) if process is not None else ():
            if pipe is not None:
                pipe.close()
        if self._errors is not None:
            self._errors.close()
            self._errors = None


class SimChild(ServerChild):
    """Runs the soft IOC, `python -m orbitfb.sim`.

    Args:
        job: What to serve.
    """

    def __init__(self, job: SimJob) -> None:
        super().__init__(job, "orbitfb.sim", "the soft IOC")
