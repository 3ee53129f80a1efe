"""Bad policies and full correctors in a loop on a real IOC; what runs here is the loop itself."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from fault_session import RATE, Session, fault_session

from orbitfb.core.clock import SystemClock
from orbitfb.core.signals import LoopState, TickRecord
from orbitfb.epics.machine import EpicsMachine
from orbitfb.epics.settings import EpicsSettings
from orbitfb.loop.guard import Safeguards
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.masking import without
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings

pytestmark = pytest.mark.system

RING = Ring.load()
RESPONSE = response(RING, "x")


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    with fault_session(tmp_path_factory.mktemp("policy-faults")) as session:
        session.command("open")
        session.service.stop()
        yield session


class Bad:
    """A good policy until it is told otherwise."""

    policy_id = "bad"

    def __init__(self) -> None:
        self.inside, self.kind = SvdPolicy(RESPONSE, SvdSettings()), "good"
        self.response = RESPONSE

    def initial_state(self) -> Any:
        return self.inside.initial_state()

    def act(self, error: Any, valid: Any, state: Any) -> Any:
        change, after = self.inside.act(error, valid, state)
        if self.kind == "raises":
            raise RuntimeError("no idea")
        if self.kind == "slow":
            time.sleep(1.2 / RATE)
        if self.kind == "away":
            change = np.where(np.arange(180) % 2, 0.2, -0.2)
        return change * (np.nan if self.kind == "nan" else 1.0), after


class Loop:
    """A loop in this process that runs on the IOC."""

    def __init__(self, machine: EpicsMachine, **settings: Any) -> None:
        self.bad, self.records = Bad(), list[TickRecord]()
        self.machine, self.stop = machine, threading.Event()
        keys = {"rate_hz": RATE, "ramp": 0.0, "hold_after": 4.0}
        self.runner = Runner(
            machine,
            PolicySlot(self.bad),
            LoopSettings(**(keys | settings.get("loop", {}))),
            settings.get("limits", LimitSettings()),
            settings.get("interlocks", InterlockSettings(current_min=None)),
            np.zeros(180),
            SystemClock(),
            start=LoopState.CLOSED,
            subscribers=(self.records.append,),
            safeguards=Safeguards(SvdPolicy(RESPONSE, SvdSettings(gain=0.6), "baseline"), without),
        )

    def until(self, what: Callable[[TickRecord], bool], timeout: float = 15.0) -> TickRecord:
        """Tick until a record shows something."""
        deadline = time.monotonic() + timeout
        while not what(record := self.runner.step()):
            assert time.monotonic() < deadline, (record.state, record.reason)
        return record


@contextmanager
def loop_on(session: Session, **settings: Any) -> Iterator[Loop]:
    with EpicsMachine(RING.channels("x"), EpicsSettings(server_port=session.port)) as machine:
        loop = Loop(machine, **settings)
        loop.until(lambda its: its.state is LoopState.CLOSED and rms(its) < 1e-6)
        yield loop


def rms(record: TickRecord) -> float:
    return (
        np.inf
        if record.reading is None
        else float(np.sqrt(np.mean(record.reading.orbit.position**2)))
    )


@pytest.mark.parametrize(
    ("kind", "word"), [("raises", "RuntimeError: no idea"), ("nan", "not finite"), ("slow", "ms")]
)
def test_a_policy_that_fails_is_replaced_within_the_tick_over_channel_access(
    session: Session, kind: str, word: str
):
    with loop_on(session) as loop:
        loop.bad.kind = kind
        session.kick(0.02)
        record = loop.until(lambda its: "baseline decides" in its.reason)
        assert word in record.reason
        assert record.state is LoopState.CLOSED and np.isfinite(record.written)
        loop.until(lambda its: its.policy_id == "baseline" and rms(its) < 1e-6)
    assert np.isfinite(session.setpoints()).all()


def test_the_others_take_over_from_correctors_at_their_limit_over_channel_access(
    session: Session,
):
    wanted = np.sort(np.abs(session.setpoints()))
    limits = LimitSettings(setpoint=float(wanted[-1]) * 1.02)
    with loop_on(session, limits=limits) as loop:
        for _ in range(20):  # the orbit is pushed about until some corrector is at its limit
            session.kick(0.06)
            loop.until(lambda its: its.state is LoopState.CLOSED and rms(its) < 5e-6)
            if any("are left out" in its.reason for its in loop.records):
                break
        assert any("at their limit" in its.reason for its in loop.records)
        assert any("% of ±" in its.reason for its in loop.records)  # warned of before
        assert all(np.abs(its.setpoints).max() <= limits.setpoint for its in loop.records[5:])
    assert np.abs(session.setpoints()).max() <= limits.setpoint


def test_after_a_distortion_the_setpoints_go_back_if_wanted(session: Session):
    interlocks = replace_settings(distortion_rms=2e-4)
    returns = {"return_after_trip": True, "return_step": 0.3, "proving": 3}
    with loop_on(session, interlocks=interlocks, loop=returns) as loop:
        before = session.setpoints()
        loop.bad.kind = "away"
        tripped = loop.until(lambda its: its.state is LoopState.TRIPPED)
        loop.until(lambda its: "returned to the last good setpoints" in its.reason)
        time.sleep(3 / RATE)
        orbit = loop.until(lambda its: its.reading is not None)
    # On a busy computer the first of its steps, 27 um, may come late and count as good.
    assert rms(tripped) > 5e-5 > rms(orbit)
    np.testing.assert_allclose(session.setpoints(), before, atol=0.5)


def replace_settings(**keys: Any) -> InterlockSettings:
    return InterlockSettings(current_min=None, **keys)
