"""Faults of single devices of a real IOC, one after the other under one closed loop."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ioc_clients import KICK, RMS, RawClient
from service_process import CHANNELS, Service, transitions, wait_for

from orbitfb.control import ask

pytestmark = pytest.mark.system

RATE = 40.0
HERE = Path(__file__).parent
CONFIG = """
[loop]
rate_hz = 40.0
ramp = 0.3
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

    def __init__(self, directory: Path, ioc: "subprocess.Popen[str]", port: int) -> None:
        self._ioc = ioc
        (directory / "c.toml").write_text(CONFIG)
        where = f"127.0.0.1:{port}"
        options = ("--config", directory / "c.toml", "--start", "closed")
        self.client = RawClient(port)
        self.client.create(RMS, KICK, *CHANNELS.setpoint_pvs)
        self.service = Service(directory / "data", where, *options)

    def fault(self, **faults: Any) -> None:
        assert self._ioc.stdin is not None
        self._ioc.stdin.write(json.dumps(faults) + "\n")
        self._ioc.stdin.flush()

    def wait(self, state: str, words: str, timeout: float = 5.0) -> dict[str, Any]:
        return self.service.wait_status(
            f"{state} with {words!r}: {self.service.status()['reason']}",
            lambda status: status["state"] == state and words in status["reason"],
            timeout,
        )

    def well(self, micrometres: float = 1.0) -> None:
        self.fault()
        self.service.wait_status(
            "recovery",
            lambda status: status["state"] == "CLOSED" and not status["reason"],
            8.0,
        )
        self.service.wait_below(micrometres)

    def again(self) -> None:
        """Close anew after a trip or with what was left out."""
        self.fault()
        if self.service.status()["state"] == "TRIPPED":
            self.command("reset")
        else:
            self.command("open")
        time.sleep(6 / RATE)
        self.command("close")
        self.well()

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


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    directory = tmp_path_factory.mktemp("faults")
    job = directory / "job.json"
    job.write_text(json.dumps({"seed": 5, "sim": {"port": 0, "rate_hz": RATE}}))
    command = [sys.executable, str(HERE / "faulty_ioc.py"), str(job)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=os.environ
    ) as ioc:
        try:
            assert ioc.stdout is not None
            session = Session(directory, ioc, int(ioc.stdout.readline()))
            with session.service, session.client:
                session.well()
                yield session
        finally:
            ioc.terminate()


@pytest.mark.parametrize(
    ("kind", "word"),
    [
        ("zero", "exactly 0"),
        ("nan", ""),
        ("stamp", ""),
        ("frozen", "frozen"),
        (0.001, "jumped"),
    ],
)
def test_a_bad_bpm_is_left_out_named_and_comes_back(session: Session, kind: object, word: str):
    session.fault(bpms={"70": kind})
    status = session.wait("CLOSED", f"1 of 180 BPMs are invalid: {CHANNELS.bpms[70]}")
    assert word in status["reason"]
    time.sleep(10 / RATE)
    assert session.true_rms() < 1.5e-6
    session.well()


def rms_where(closed: np.ndarray, orbit: np.ndarray, valid: np.ndarray) -> np.ndarray:
    counted = np.where(valid, orbit, 0.0)[closed]
    return np.sqrt(np.mean(counted**2, axis=1))


def test_three_bad_bpms_in_a_row_hold_until_they_are_back(session: Session):
    session.fault(bpms={"70": "zero", "71": "nan", "72": "zero"})
    session.wait("HELD", "3 of them next to each other, allowed: 2")
    session.well()


def test_a_nan_bpm_is_not_read_as_on_reference(session: Session):
    """Nor is one that reads exactly 0: neither counts as an error of nought."""
    session.fault(bpms={"11": "nan", "40": "zero"})
    session.wait("CLOSED", "2 of 180 BPMs are invalid")
    session.kick(0.05)
    time.sleep(0.5)
    session.service.wait_below(1.0)
    assert session.true_rms() < 2e-6  # also where nothing is read
    session.well()


def test_an_orbit_of_zeros_holds(session: Session):
    session.fault(bpms={str(index): "zero" for index in range(180)})
    session.wait("HELD", "180 of 180 BPMs are invalid")
    session.well()


def strongest(session: Session, count: int) -> list[int]:
    return np.argsort(-np.abs(session.setpoints()))[:count].tolist()


@pytest.mark.parametrize("kind", ["off", "away", 0.5])
def test_a_corrector_that_does_not_follow_is_left_out(session: Session, kind: object):
    bad = strongest(session, 1)[0]
    session.fault(correctors={str(bad): kind})
    named = f"1 correctors do not follow and are left out: {CHANNELS.correctors[bad]}"
    session.wait("CLOSED", named)
    session.service.wait_below(20.0)
    session.again()


def test_a_dead_corrector_does_not_let_setpoints_and_hardware_part_ways(session: Session):
    bad = strongest(session, 1)[0]
    session.fault(correctors={str(bad): "stuck"})
    was = session.setpoints()[bad]
    for _ in range(2):  # each asks for much more of it than the tolerance of a readback
        session.kick(0.3)
        time.sleep(0.5)
    assert abs(session.setpoints()[bad] - was) < 0.6
    session.again()


def test_more_correctors_than_may_be_lost_trip(session: Session):
    session.fault(correctors=dict.fromkeys(map(str, strongest(session, 5)), "off"))
    session.wait("TRIPPED", "5 correctors do not follow their setpoint")
    session.again()


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ({"current": None}, "is not known"),
        ({"current_old": True}, "is not known"),
        ({"current": 300.0}, "dropped"),
        ({"current": 5.0}, "below the 10 mA"),
    ],
)
def test_the_stored_current_trips(session: Session, fault: dict[str, Any], words: str):
    trips = len(session.service.events("postmortem_written"))
    session.fault(**fault)
    session.wait("TRIPPED", words)
    left = session.setpoints()
    wait_for("post-mortem", lambda: len(session.service.events("postmortem_written")) > trips)
    np.testing.assert_array_equal(session.setpoints(), left)
    session.fault(current=400.0)
    time.sleep(3 / RATE)
    session.again()


@pytest.mark.parametrize("fault", [{"sign": -1.0}, {"shift": 7}])
def test_a_wrong_response_is_found_before_the_orbit_is_lost(
    session: Session, fault: dict[str, Any]
):
    session.command("open")
    session.fault(**fault)
    time.sleep(4 / RATE)
    first = session.service.status()["ticks"]
    session.command("close")
    status = session.wait("TRIPPED", "")
    told = ("does not answer as the response matrix says", "grew for")  # from a tiny orbit
    assert any(words in status["reason"] for words in told)
    tripped = session.service.events("loop_state_changed")[-1]
    assert tripped["tick"] - first < (15 if "answer" in status["reason"] else 30)
    archived = transitions(session.service.data)
    assert rms_where(archived.closed, archived.orbit, archived.valid)[-10:].max() < 1e-3
    session.again()


def test_a_frozen_orbit_is_not_integrated(session: Session):
    session.fault(bpms={str(index): "frozen" for index in range(180)})
    session.wait("HELD", "all 180 readings are those of the orbit before")
    left = session.setpoints()
    time.sleep(0.3)
    np.testing.assert_array_equal(session.setpoints(), left)
    session.well()
