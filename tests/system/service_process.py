"""The program as its users start it: processes, commands, log, archive."""

import contextlib
import io
import json
import os
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
import psutil
import pytest
from forked import finish, start
from free_ports import free_port
from ioc_clients import RawClient

from orbitfb.cli.app import main
from orbitfb.control.client import ask
from orbitfb.core.errors import ControlError
from orbitfb.core.transitions import Transitions
from orbitfb.history.archive import read_archive
from orbitfb.physics.places import Ring

PROGRAM = (sys.executable, "-W", "error::ResourceWarning", "-m", "orbitfb")
CHANNELS = Ring.load().channels("x")
START = 120.0
"""How long a start may take on a loaded computer [s]."""
PATIENCE = 4.0
"""How much longer what takes a while on an idle computer may take on a loaded one."""
SOONEST, LATEST = 0.02, 0.2
"""From one look to the next, at first and after a while [s]: a look at the metrics takes 8 ms of
computing, at every look of a long wait a tenth of what all the tests compute."""
GROWTH = 1.1
"""How much longer each pause is than the one before [1]: a tenth of the wait until then."""


Done = subprocess.CompletedProcess[str]

WATCH, CONNECT = "ORBITFB_DIAGNOSE__LIVE__ENABLED", "ORBITFB_EPICS__CONNECT_TIMEOUT"
ANSWER = "ORBITFB_EPICS__ANSWER_TIMEOUT"
LEARN, PAGE = "ORBITFB_LEARN__ENABLED", "ORBITFB_WEB__ENABLED"
LEAN = ("run", "measure-response")
"""Commands that get less than their users' by default."""


def lean(arguments: Sequence[object]) -> dict[str, str]:
    """Keep `run` from what few tests look at: operator page, learner, and watch over the gap.

    Each is a process more: page and trainer take a second of computing, a look at the gap half a
    minute.
    """
    if arguments[0] not in LEAN:
        return {}
    # On a loaded computer 540 channels may take longer to connect than the usual 5 s, and to answer
    # than the usual second.
    return {
        PAGE: "false", LEARN: "false", WATCH: "false", CONNECT: str(START / 2), ANSWER: "10.0",
    }  # fmt: skip


def orbitfb(*arguments: object, **environment: str | None) -> Done:
    """Run a command to its end; a variable that is None is unset.

    What runs on, and what speaks Channel Access, has a process of its own; others run in this one,
    which has imported the program already.
    """
    own = arguments[0] in (*LEAN, "ioc", "doctor")
    return (as_process if own else here)(*arguments, **environment)


def as_process(*arguments: object, **environment: str | None) -> Done:
    """Run a command to its end in a process of its own."""
    given = os.environ | lean(arguments) | environment
    variables = {k: v for k, v in given.items() if v is not None}
    return finish([str(each) for each in arguments], variables, 1.5 * START)


def here(*arguments: object, **environment: str | None) -> Done:
    """Run a command to its end in this process; what it leaves behind fails the test."""
    given = lean(arguments) | environment
    out, err = io.StringIO(), io.StringIO()
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        patch.setattr(sys, "argv", ["orbitfb", *map(str, arguments)])
        for name, value in given.items():
            patch.delenv(name, raising=False) if value is None else patch.setenv(name, value)
        try:
            main()
            code: object = 0
        except SystemExit as end:
            code = end.code or 0
    assert isinstance(code, int)
    return subprocess.CompletedProcess(arguments, code, out.getvalue(), err.getvalue())


def refused(*arguments: object, process: bool = False, **environment: str | None) -> str:
    """Run a command that must be refused; gives what it said, without the name of the program.

    Args:
        arguments: What follows `orbitfb`.
        process: Whether it has a process of its own: where it speaks Channel Access.
        environment: Variables; one that is None is unset.
    """
    done = (as_process if process else here)(*arguments, **environment)
    assert done.returncode == 2, (done.returncode, done.stdout, done.stderr)
    assert done.stdout == "", done.stdout
    assert "Traceback" not in done.stderr
    assert done.stderr.startswith("orbitfb: ") and done.stderr.endswith("\n")
    return done.stderr.removeprefix("orbitfb: ").rstrip("\n")


def wait_for(what: str, look: Callable[[], Any], timeout: float = START) -> Any:
    """Look again and again until there is something to see.

    A loaded computer gets more time than `timeout`, as much as for a start at most. Looks are
    counted, not seconds: a computer that stands still for a while looks no more often.
    """
    most = min(PATIENCE * timeout, max(timeout, START))
    waited, pause = 0.0, SOONEST
    while waited < most:
        if seen := look():
            return seen
        time.sleep(pause)
        waited += pause
        pause = min(GROWTH * pause, LATEST)
    raise AssertionError(f"no {what} within {most} s")


def read_log(data: Path) -> list[dict[str, Any]]:
    """Every line of the log of a data directory; a line that is no JSON fails."""
    file = data / "orbitfb.log.jsonl"
    if not file.exists():
        return []
    text = file.read_text()
    return [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()]


class Process:
    """A process of the program that is never left behind.

    Args:
        arguments: What follows `orbitfb`.
        directory: Where what it prints is kept.
        name: Of the files there.
        variables: Of the environment, besides.
    """

    def __init__(
        self,
        arguments: Sequence[object],
        directory: Path,
        name: str,
        variables: Mapping[str, str] | None = None,
    ) -> None:
        self._out, self._err = directory / f"{name}.out", directory / f"{name}.err"
        with self._out.open("w") as out, self._err.open("w") as err:
            environment = {**os.environ, **lean(arguments), **(variables or {})}
            self.popen = start([str(each) for each in arguments], out, err, environment)

    @property
    def out(self) -> str:
        """What it printed so far."""
        return self._out.read_text()

    @property
    def err(self) -> str:
        """What it said on standard error so far."""
        return self._err.read_text()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.popen.pid, signal.SIGKILL)
        self.popen.wait(START)

    @contextlib.contextmanager
    def starting(self) -> Iterator[None]:
        """End it if it does not start."""
        try:
            yield
        except BaseException:
            self.__exit__()
            raise

    def kill(self) -> None:
        """kill -9."""
        self.popen.kill()
        self.popen.wait(START)

    def stop(self, number: int = signal.SIGINT) -> float:
        """Send a signal, and give the time until it has ended [s]."""
        begin = time.monotonic()
        self.popen.send_signal(number)
        self.popen.wait(START)
        return time.monotonic() - begin

    def check_alive(self) -> None:
        assert self.popen.poll() is None, f"it ended: {self.out}\n{self.err}"


class Ioc(Process):
    """`orbitfb ioc`, once it serves.

    Args:
        directory: Where what it prints is kept.
        port: Port; 0: a free one that another one can have after it.
        options: More options.
    """

    def __init__(self, directory: Path, port: int = 0, options: Sequence[object] = ()) -> None:
        super().__init__(["ioc", "--port", port or free_port(), *options], directory, "ioc")
        with self.starting():
            wait_for("IOC", lambda: self.check_alive() or self.out.count("\n") == 2)
        self.ready = time.time()
        self.port = int(self.out.split("EPICS_CA_SERVER_PORT=")[1])


class Service(Process):
    """`orbitfb run`, once it has started.

    Args:
        data: Data directory.
        ioc: Value of `--ioc`.
        options: More options.
        page: Port of the operator page; 0: any; None: there is no page.
        watch: Whether it watches its gap.
        learn: Whether it learns.
    """

    def __init__(
        self,
        data: Path,
        ioc: str,
        *options: object,
        page: int | None = None,
        watch: bool = False,
        learn: bool = False,
    ) -> None:
        self.data = data
        before = len(self.events("service_started"))
        arguments = ["run", "--ioc", ioc, "--data", data, "--metrics-port", free_port()]
        ring = ["--port", free_port()] if ioc == "sim" else []
        variables = {WATCH: str(watch).lower(), LEARN: str(learn).lower()}
        if page is not None:
            variables |= {PAGE: "true", "ORBITFB_WEB__PORT": str(page)}
        super().__init__([*arguments, *ring, *options], data.parent, data.name, variables)
        self.began = time.monotonic()
        with self.starting():
            self.where = wait_for("start", lambda: self.check_alive() or self._started(before))

    def _started(self, before: int) -> dict[str, Any] | None:
        found = self.events("service_started")[before:]
        return found[0] if found else None

    def child(self, module: str) -> psutil.Process:
        """Give the child that runs a module: `orbitfb.sim` (the ring), `orbitfb.learn`."""

        def look() -> list[psutil.Process]:
            children = psutil.Process(self.popen.pid).children()
            return [child for child in children if module in child.cmdline()]

        return wait_for(module, look)[0]

    @property
    def port(self) -> int:
        """Port of the ring."""
        return self.where["port"]

    def events(self, name: str) -> list[dict[str, Any]]:
        """Lines of the log about one event."""
        return [line for line in read_log(self.data) if line["event"] == name]

    def status(self) -> dict[str, Any]:
        """Ask how it is."""
        return ask(self.data, {"command": "status"})

    def wait_status(self, what: str, look: Callable[[dict[str, Any]], Any], timeout: float) -> Any:
        """Wait until its status shows something; gives that status."""
        last: dict[str, Any] = {}

        def once() -> dict[str, Any] | None:
            nonlocal last
            self.check_alive()
            try:
                last = self.status()
            except ControlError:
                return None
            return last if look(last) else None

        try:
            return wait_for(what, once, timeout)
        except AssertionError as error:
            raise AssertionError(f"{error}, but {last}") from None

    def wait_state(self, state: str, timeout: float = START) -> Any:
        """Wait until it is in a state."""
        return self.wait_status(state, lambda status: status["state"] == state, timeout)

    def wait_below(self, micrometres: float, timeout: float = START) -> None:
        """Wait until it is closed and the last orbit, as Prometheus is told, is that good."""

        def good(status: dict[str, Any]) -> bool:
            return status["state"] == "CLOSED" and self.orbit_rms() < micrometres

        self.wait_status(f"orbit below {micrometres} um", good, timeout)

    def orbit_rms(self, plane: str = "x") -> float:
        """Observed rms of the last orbit [µm]."""
        return self.metric(f'orbitfb_orbit_rms_meters{{plane="{plane}"}}') * 1e6

    def metrics(self) -> str:
        """What Prometheus gets."""
        return fetch(f"{self.where['metrics']}/metrics")

    def metric(self, name: str) -> float:
        """One sample, by its name with its labels; NaN where it is not told now."""
        told = (line for line in self.metrics().splitlines() if line.startswith(f"{name} "))
        return float(next(told, "nan nan").split()[1])


def fetch(url: str) -> str:
    """GET over HTTP."""
    with urllib.request.urlopen(url, timeout=START) as answer:
        return answer.read().decode()


def transitions(data: Path) -> Transitions:
    """Read the archive of a data directory; whatever cannot be read fails."""
    return read_archive(data / "archive")


def rms(vectors: np.ndarray) -> np.ndarray:
    """Rms of each row."""
    return np.sqrt(np.mean(vectors**2, axis=1))


def setpoints(port: int, channels: Any = CHANNELS) -> np.ndarray:
    """Read the setpoints [A], as any client may."""
    with RawClient(port) as client:
        client.create(*channels.setpoint_pvs)
        return np.array([client.get(name).value for name in channels.setpoint_pvs])
