"""Start `base_ioc.py` for a test and never leave it behind."""

import json
import os
import selectors
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from free_ports import free_port

from orbitfb.core.names import any_over_pva
from orbitfb.core.signals import Channels
from orbitfb.epics.settings import EpicsSettings, PvaSettings
from orbitfb.sim.access.pva import server_keys

SCRIPT = Path(__file__).with_name("base_ioc.py")
CURRENT, RF_FREQUENCY = 400.0, 499.68e6
AUXILIARY = {"SR:C03-BI{DCCT:1}I:Real-I": CURRENT, "RF{Osc:1}Freq:SP": RF_FREQUENCY}


def small_ring(size: int) -> Channels:
    """The names of a ring of `size` BPMs and correctors in the machine's own style."""
    cells = [(index // 6 + 1, index % 6 + 1) for index in range(size)]
    return Channels(
        planes="x",
        bpms=tuple(f"P{i}_C{c:02d}" for c, i in cells),
        correctors=tuple(f"C{i}_C{c:02d}" for c, i in cells),
        orbit_pvs=tuple(f"SR:C{c:02d}-BI{{BPM:{i}}}Pos:X-I" for c, i in cells),
        setpoint_pvs=tuple(f"SR:C{c:02d}-MG{{PS:CH{i}A}}I:Sp1-SP" for c, i in cells),
        readback_pvs=tuple(f"SR:C{c:02d}-MG{{PS:CH{i}A}}I:Ps1DCCT1-I" for c, i in cells),
    )


def as_arrays(channels: Channels, over: str = "") -> Channels:
    """The same devices as elements of three arrays, whose names begin so."""
    n, m = len(channels.orbit_pvs), len(channels.setpoint_pvs)
    return replace(
        channels,
        orbit_pvs=tuple(f"{over}SR:Orbit-I.[{index}]" for index in range(n)),
        setpoint_pvs=tuple(f"{over}SR:Currents-SP.[{index}]" for index in range(m)),
        readback_pvs=tuple(f"{over}SR:Currents-I.[{index}]" for index in range(m)),
    )


def is_coherent(position: np.ndarray) -> bool:
    """Whether all BPMs show the same tick: BPM i reads tick + i * 1e-6 [mm]."""
    tick = position * 1e3 - np.arange(position.size) * 1e-6
    return bool(np.ptp(tick[np.isfinite(tick)]) < 1e-9)


class BaseIoc:
    """One IOC process on one port; start, kill, freeze and start again."""

    def __init__(
        self,
        channels: Channels,
        rate_hz: float = 20.0,
        port: int | None = None,
        auxiliary: dict[str, float] | None = None,
        read_only: bool = False,
        plant_seed: int | None = None,
        setpoint_record: str = "ao",
        bpm_unit: str = "",
        records: str = "",
        pva: bool = False,
    ) -> None:
        self.port, self.pva_port = port or free_port(), free_port()
        self._job = {
            "orbit_pvs": channels.orbit_pvs,
            "setpoint_pvs": channels.setpoint_pvs,
            "readback_pvs": channels.readback_pvs,
            "auxiliary": AUXILIARY if auxiliary is None else auxiliary,
            "rate_hz": rate_hz,
            "read_only": read_only,
            "plant_seed": plant_seed,
            "setpoint_record": setpoint_record,
            "bpm_unit": bpm_unit,
            "pva": pva or any_over_pva(channels.pvs),
            "records": records,
        }
        self._process: subprocess.Popen[bytes] | None = None
        self._folder = tempfile.TemporaryDirectory()

    @property
    def settings(self) -> EpicsSettings:
        """How a machine finds it."""
        return EpicsSettings(server_port=self.port, pva=PvaSettings(port=self.pva_port))

    def start(self) -> float:
        """Start and wait for READY; returns that moment, monotonic clock [s]."""
        job = Path(self._folder.name, "job.json")
        job.write_text(json.dumps(self._job))
        environment = os.environ | {
            "EPICS_CAS_SERVER_PORT": str(self.port),
            "EPICS_CAS_INTF_ADDR_LIST": "127.0.0.1",
            "EPICS_CAS_AUTO_BEACON_ADDR_LIST": "NO",
            "EPICS_CAS_BEACON_ADDR_LIST": "127.0.0.1",
            "EPICS_CAS_BEACON_PORT": str(free_port()),
            "EPICS_CA_ADDR_LIST": "127.0.0.1",
            "EPICS_CA_AUTO_ADDR_LIST": "NO",
            **server_keys("127.0.0.1", self.pva_port),
        }
        self._process = subprocess.Popen(
            [sys.executable, str(SCRIPT), str(job)],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        self._await_ready(self._process)
        return time.monotonic()

    def kill(self) -> None:
        """End it with SIGKILL."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            if self._process.stdout is not None:
                self._process.stdout.close()
            self._process = None

    def freeze(self) -> None:
        """Let it hang: nothing is answered, no connection is closed."""
        self.signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """Let it go on."""
        self.signal(signal.SIGCONT)

    def signal(self, number: int) -> None:
        if self._process is None:
            raise RuntimeError("the IOC does not run")
        self._process.send_signal(number)

    def __enter__(self) -> "BaseIoc":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()
        self._folder.cleanup()

    def _await_ready(self, process: subprocess.Popen[bytes]) -> None:
        if process.stdout is None:
            raise RuntimeError("the IOC was started without its pipe")
        said, deadline = b"", time.monotonic() + 120.0
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            while b"READY\n" not in said:
                left = deadline - time.monotonic()
                piece = os.read(process.stdout.fileno(), 4096) if selector.select(left) else b""
                if not piece:
                    self.kill()
                    raise RuntimeError(f"the IOC did not start: {said.decode()}")
                said += piece
