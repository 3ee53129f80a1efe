"""kill -9 of the controller and of the IOC: nothing is lost, nothing moves by itself."""

import signal
import time
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from service_process import (
    CHANNELS,
    PATIENCE,
    START,
    Ioc,
    Service,
    orbitfb,
    rms,
    setpoints,
    transitions,
)

from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.store.directory import PolicyStore
from orbitfb.policies.svd import SvdPolicy, SvdSettings

pytestmark = pytest.mark.system

PERIOD = 0.1
RAMPED, RAMP_TICKS = 0.5, 9
"""Share of the gain between that of the first of ten ticks, 0.1, and those from the tenth on; what
asks the ring changes either by some 0.2."""


def wall(event: dict[str, Any]) -> float:
    """When a line was logged [s since the epoch]."""
    return datetime.fromisoformat(event["timestamp"]).timestamp()


def states(service: Service) -> list[dict[str, Any]]:
    return service.events("loop_state_changed")


class Killed:
    """A controller that was killed while it held the orbit, and the ring that is left."""

    def __init__(self, tmp_path: Path, ioc: Ioc) -> None:
        self.data, self.ioc = tmp_path / "data", ioc
        with Service(self.data, f"127.0.0.1:{ioc.port}", "--start", "closed") as service:
            service.wait_below(0.5)
            self.policy = service.where["policy"]
            service.kill()
            self.time = time.time()
        self.left = setpoints(ioc.port)


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Killed]:
    directory = tmp_path_factory.mktemp("killed")
    with Ioc(directory) as ioc:
        yield Killed(directory, ioc)


def test_setpoints_stay_when_the_controller_is_killed(killed: Killed):
    assert rms(killed.left[None])[0] > 0.01
    time.sleep(0.5)
    np.testing.assert_array_equal(setpoints(killed.ioc.port), killed.left)


def test_its_archive_opens_and_misses_at_most_the_last_second(killed: Killed):
    """On a computer that others use, which may stand still for a second besides."""
    archived = transitions(killed.data)
    assert killed.time - 2.0 - PERIOD < archived.next_time[-1] < killed.time
    assert archived.usable[archived.tick > 5].mean() > 0.9
    # The last setpoints on disk are those that the ring has, but for what that second did.
    step = np.abs(archived.applied[-20:]).max()
    assert np.abs(archived.setpoints[-1] - killed.left).max() < step / PERIOD


def test_restart_resumes_from_the_stored_policy_and_stays_open(killed: Killed):
    with Service(killed.data, f"127.0.0.1:{killed.ioc.port}") as service:
        assert service.where["policy"] == killed.policy
        status = service.wait_status("ticks", lambda status: status["ticks"] > 10, 10.0)
        assert (status["state"], status["policy"]) == ("OPEN", killed.policy)
        service.stop()
    np.testing.assert_array_equal(setpoints(killed.ioc.port), killed.left)


def test_restart_takes_up_the_policy_that_was_activated(killed: Killed, tmp_path: Path):
    """Not the baseline of the configuration: what is in force is what was stored."""
    store = PolicyStore(killed.data / "policies")
    gentle = SvdPolicy(response(Ring.load(), "x"), SvdSettings(gain=0.3))
    store.save(gentle, CHANNELS)
    store.activate(gentle.policy_id)
    with Service(killed.data, f"127.0.0.1:{killed.ioc.port}") as service:
        assert service.where["policy"] == gentle.policy_id != killed.policy
    store.rollback()


def test_restart_closes_by_itself_without_a_bump_if_so_told(killed: Killed):
    before = len(transitions(killed.data))
    with Service(killed.data, f"127.0.0.1:{killed.ioc.port}", "--start", "closed") as service:
        assert service.where["policy"] == killed.policy
        service.wait_state("CLOSED")
        closed = service.status()["ticks"]
        service.wait_status("ticks", lambda status: status["ticks"] > closed + 20, START)
        service.stop()
    archived = transitions(killed.data)
    assert archived.closed[before:].sum() > 15
    # The ground has moved since the kill, the longer the busier the computer: closing adds nothing.
    seen = rms(archived.orbit[before:])
    assert seen.max() < max(1e-6, 1.2 * seen[0]) and seen[0] < 20e-6
    assert seen[-1] < 1e-6
    first_setpoints = archived.setpoints[before:][archived.closed[before:]][0]
    assert np.abs(first_setpoints - killed.left).max() < 1e-9


def away(tmp_path: Path, seconds: float) -> tuple[float, float, Service]:
    """Kill the IOC of a closed loop and bring it back; give both moments [s since the epoch]."""
    with Ioc(tmp_path) as ioc:
        port = ioc.port
        service = Service(tmp_path / "data", f"127.0.0.1:{port}", "--start", "closed")
        with service:
            service.wait_below(0.5)
            killed = time.time()
            ioc.kill()
            time.sleep(seconds)
            with Ioc(tmp_path, port) as back:
                service.wait_status(
                    "closing",
                    lambda status: status["state_entries"]["CLOSED"] == 2,
                    10.0,
                )
                service.wait_below(1.0)
                service.stop()
                return killed, back.ready, service


@pytest.mark.timing
@pytest.mark.parametrize("seconds", [2.0, pytest.param(30.0, marks=pytest.mark.nightly)])
def test_killed_ioc_holds_the_loop_until_it_is_back(seconds: float, tmp_path: Path):
    killed, ready, service = away(tmp_path, seconds)
    entered = states(service)
    assert [event["state"] for event in entered] == ["HELD", "CLOSED", "HELD", "CLOSED"]
    held, closed = entered[2:]
    archived = transitions(service.data)
    last_orbit = archived.next_time[archived.next_time < killed + PERIOD][-1]
    assert wall(held) - last_orbit < 2 * PERIOD + 0.02  # the line is stamped after the decision
    assert "543 channels are disconnected" in held["reason"] or "542" in held["reason"]
    assert wall(closed) - ready < 3.0 * PATIENCE
    written = archived.written[np.isfinite(archived.written)]
    assert not ((written > wall(held)) & (written < ready)).any()
    # The ring is a new one, 250 µm off: the gain is ramped again, from its own setpoints. What is
    # sent asks the ring besides, at random and as much as a first step: the share of what the law
    # asks for on the orbit tells the gain.
    again = archived.closed & (archived.time > ready)
    assert np.abs(archived.setpoints[again][0]).max() == 0.0
    law = SvdPolicy(response(Ring.load(), "x"), SvdSettings()).gain_matrix
    wanted = -archived.orbit[again] @ law.T
    shares = np.sum(archived.applied[again] * wanted, axis=1) / np.sum(wanted**2, axis=1)
    assert shares[0] < RAMPED < np.median(shares[RAMP_TICKS : RAMP_TICKS + 5])


@pytest.mark.timing
def test_a_frozen_ioc_is_noticed_too(tmp_path: Path):
    """SIGSTOP: connected, but silent; nothing is written to it, and nothing old arrives later."""
    with Ioc(tmp_path) as ioc:
        service = Service(tmp_path / "data", f"127.0.0.1:{ioc.port}", "--start", "closed")
        with service:
            service.wait_below(0.5)
            ioc.popen.send_signal(signal.SIGSTOP)
            stopped = time.time()
            service.wait_state("HELD", 2.0)
            time.sleep(1.0)
            ioc.popen.send_signal(signal.SIGCONT)
            resumed = time.time()
            service.wait_state("CLOSED", 5.0)
            service.wait_below(1.0, 5.0)
            service.stop()
    held = states(service)[2]
    assert wall(held) - stopped < 3 * PERIOD
    written = transitions(service.data).written
    written = written[np.isfinite(written)]
    assert not ((written > wall(held)) & (written < resumed)).any()


@pytest.mark.nightly
def test_the_store_survives_a_kill_while_it_is_written(tmp_path: Path):
    """A controller killed during its start leaves no child, and the next one does not stumble."""
    data = tmp_path / "data"
    with Service(data, "sim", "--duration", 60, learn=True) as service:
        children = [service.child(module) for module in ("orbitfb.sim", "orbitfb.learn")]
        service.kill()
        for child in children:
            child.wait(20.0)
    again = orbitfb(
        *("run", "--ioc", "sim", "--port", 0, "--metrics-port", 0, "--data", data),
        *("--duration", 1, "--summary", tmp_path / "s.json"),
    )
    assert (again.returncode, again.stderr) == (0, "")
    assert (tmp_path / "s.json").exists()
