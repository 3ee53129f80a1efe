"""Starts of the program by the fork server, with what `subprocess.Popen` tells of a process."""

import array
import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO

PLAIN = "PLAIN_STARTS"
"""Environment variable that lets every start be one of `python -m orbitfb`: make nightly does."""
SERVER = Path(__file__).with_name("fork_server.py")
_server: list[socket.socket] = []
_used = [0.0]


def used() -> float:
    """CPU seconds that all processes which have ended took."""
    return _used[0]


@contextlib.contextmanager
def fork_server() -> Iterator[None]:
    """Have a server as long as this lasts."""
    if os.environ.get(PLAIN):
        yield
        return
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    command = [sys.executable, "-W", "error::ResourceWarning", str(SERVER), str(theirs.fileno())]
    with ours:
        with theirs:
            server = subprocess.Popen(command, pass_fds=[theirs.fileno()])
        _server.append(ours)
        try:
            yield
        finally:
            _server.clear()
            ours.close()
            server.wait(60.0)
            _used[0] = 0.0  # from here on they are among the children that were awaited


def _read_at_start(environment: Mapping[str, str]) -> bool:
    """Whether an interpreter reads variables at its start that are other ones here."""
    names = {name for name in {*environment, *os.environ} if name.startswith("PYTHON")}
    return any(environment.get(name) != os.environ.get(name) for name in names)


def start(
    arguments: Sequence[str],
    out: IO[str],
    err: IO[str],
    environment: Mapping[str, str],
    script: str = "",
) -> "subprocess.Popen[bytes] | Forked":
    """Start the program, or a script, in a session of its own.

    Args:
        arguments: What follows `orbitfb`.
        out: Gets its standard output.
        err: Gets its standard error.
        environment: All of its variables.
        script: What is done instead of the program; empty: the program.
    """
    if _server and not _read_at_start(environment):
        return Forked(_server[0], arguments, out, err, environment, script)
    what = ["-c", script] if script else ["-m", "orbitfb"]
    command = [sys.executable, "-W", "error::ResourceWarning", *what, *arguments]
    return subprocess.Popen(
        command, stdout=out, stderr=err, start_new_session=True, env=environment
    )


def finish(
    arguments: Sequence[str], environment: Mapping[str, str], timeout: float, script: str = ""
) -> "subprocess.CompletedProcess[str]":
    """Start, and wait for the end; gives code and output as `subprocess.run` does.

    Args:
        arguments: What follows `orbitfb`.
        environment: All variables.
        timeout: How long it may take [s].
        script: What is done instead of the program; empty: the program.
    """
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        process = start(arguments, out, err, environment, script)
        try:
            code = process.wait(timeout)
        except BaseException:
            process.kill()
            process.wait()
            raise
        out.seek(0)
        err.seek(0)
        return subprocess.CompletedProcess(list(arguments), code, out.read(), err.read())


class Forked:
    """A child of the fork server.

    Attributes:
        pid: Its number.
        returncode: As `subprocess.Popen` has it; None as long as it runs.
    """

    def __init__(
        self,
        server: socket.socket,
        arguments: Sequence[str],
        out: IO[str],
        err: IO[str],
        environment: Mapping[str, str],
        script: str,
    ) -> None:
        self.returncode: int | None = None
        read, write = os.pipe()
        asked = {
            "arguments": list(arguments),
            "environment": dict(environment),
            "script": script,
        }
        try:
            descriptors = array.array("i", [out.fileno(), err.fileno(), write])
            rights = (socket.SOL_SOCKET, socket.SCM_RIGHTS, descriptors)
            server.sendmsg([json.dumps(asked).encode()], [rights])
        finally:
            os.close(write)
        self._told = os.fdopen(read, "rb", buffering=0)
        self.pid = int(self._line())

    def _line(self) -> str:
        line = b""
        while not line.endswith(b"\n"):
            piece = self._told.read(1)
            if not piece:
                raise AssertionError("the fork server has died")
            line += piece
        return line.decode()

    def poll(self) -> int | None:
        """Return code if it has ended."""
        return self._look(0.0)

    def _look(self, timeout: float | None) -> int | None:
        if self.returncode is None and select.select([self._told], [], [], timeout)[0]:
            status, seconds = self._line().split()
            self._told.close()
            _used[0] += float(seconds)
            self.returncode = os.waitstatus_to_exitcode(int(status))
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait until it has ended.

        Raises:
            TimeoutExpired: It has not.
        """
        code = self._look(timeout)
        if code is None:
            raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """kill -9."""
        self.send_signal(signal.SIGKILL)
