"""A closed loop of the program on a soft IOC whose devices fail on request."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from ioc_clients import KICK, RMS, RawClient
from service_process import CHANNELS, START, Service, wait_for

from orbitfb.control.client import ask
from orbitfb.core.errors import ControlError

RATE = 40.0
"""Of ring and loop, unless a test says another [Hz]."""
SILENT = "does not answer the correctors"
HERE = Path(__file__).parent
CONFIG = """
[loop]
ramp = 0.3
hold_after = 8.0  # a computer that is busy with other tests is no trouble of the ring
policy_deadline = 40.0
[learn]
enabled = false
[diagnose.live]
enabled = false
[postmortem]
before = 1.0
after = 0.2
[epics.auxiliary.current]
pv = "SR:C03-BI{DCCT:1}I:Real-I"
scale = 1e-3
stale_after = 0.5
"""


class Session:
    """A closed loop on an IOC whose faults can be switched."""

    def __init__(
        self,
        directory: Path,
        ioc: "subprocess.Popen[str]",
        port: int,
        more: str = "",
        rate: float = RATE,
    ) -> None:
        self._ioc, self.port = ioc, port
        config = CONFIG.replace("[loop]", f"[loop]\nrate_hz = {rate}")
        (directory / "c.toml").write_text(config + more)
        where = f"127.0.0.1:{port}"
        options = ("--config", directory / "c.toml", "--start", "closed")
        self.client = RawClient(port)
        self.client.create(RMS, KICK, *CHANNELS.setpoint_pvs)
        self.service = Service(directory / "data", where, *options)

    def fault(self, **faults: Any) -> None:
        assert self._ioc.stdin is not None
        self._ioc.stdin.write(json.dumps(faults) + "\n")
        self._ioc.stdin.flush()

    def wait(self, state: str, words: str, timeout: float = 20.0) -> dict[str, Any]:
        return self.service.wait_status(
            f"{state} with {words!r}",
            lambda status: status["state"] == state and words in status["reason"],
            timeout,
        )

    def well(self, micrometres: float = 1.0) -> None:
        """Wait until all is well again.

        On a busy computer an answer may come late again and again. Then a device seems silent; as
        an operator does, the loop is opened and closed: that is another test's business.
        """
        self.fault()
        status = self.service.wait_status(
            "recovery",
            lambda status: (
                status["state"] == "CLOSED" and (not status["reason"] or SILENT in status["reason"])
            ),
            START,
        )
        if status["reason"]:
            self.again()
        self.service.wait_below(micrometres)

    def again(self) -> None:
        """Close anew after a trip or with what was left out."""
        self.fault()
        wait_for("OPEN", self._opened)
        ticks = self.service.status()["ticks"]
        self.service.wait_status("ticks", lambda status: status["ticks"] > ticks + 6, START)
        self.command("close")
        self.well()

    def _opened(self) -> bool:
        state = self.service.status()["state"]
        with suppress(ControlError):  # it may trip before the command comes
            if state != "OPEN":
                self.command("reset" if state == "TRIPPED" else "open")
        return state == "OPEN"

    def command(self, name: str) -> None:
        ask(self.service.data, {"command": name})

    def true_rms(self) -> float:
        """Where the beam truly is [m]."""
        return self.client.get(RMS).value * 1e-3

    def kick(self, millimetres: float) -> None:
        self.client.put_waiting(KICK, millimetres)

    def setpoints(self) -> np.ndarray:
        """What is in force at the IOC [A]."""
        return np.array([self.client.get(name).value for name in CHANNELS.setpoint_pvs])


@contextmanager
def fault_session(
    directory: Path, more: str = "", micrometres: float = 1.0, rate: float = RATE, **ring: Any
) -> Iterator[Session]:
    """Start IOC and loop; wait until the orbit is good.

    Args:
        directory: For their files.
        more: Configuration besides, as TOML.
        micrometres: Rms of an orbit that is good [µm].
        rate: Of ring and loop [Hz].
        ring: More of the job of the IOC.
    """
    job = directory / "job.json"
    job.write_text(json.dumps({"seed": 5, "sim": {"port": 0, "rate_hz": rate}, **ring}))
    command = [sys.executable, str(HERE / "faulty_ioc.py"), str(job)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=os.environ
    ) as ioc:
        try:
            assert ioc.stdout is not None
            session = Session(directory, ioc, int(ioc.stdout.readline()), more, rate)
            with session.service, session.client:
                session.well(micrometres)
                yield session
        finally:
            ioc.terminate()
