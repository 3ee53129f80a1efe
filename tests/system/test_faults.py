"""Faults of single BPMs and correctors of a real IOC, one after the other under one closed loop."""

import time
from collections.abc import Iterator

import numpy as np
import pytest
from fault_session import RATE, Session, fault_session
from service_process import CHANNELS

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    with fault_session(tmp_path_factory.mktemp("faults")) as session:
        yield session


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
