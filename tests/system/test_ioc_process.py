"""The soft IOC as a process: ports, signals, parents that die."""

import os
import signal
import socket
import subprocess
import sys
import textwrap
import time

import psutil
import pytest
from ioc_clients import READINGS, TICK, RawClient, serving

from orbitfb.core.errors import MachineError, OwnershipError
from orbitfb.physics.places import Ring
from orbitfb.sim.child import SimChild
from orbitfb.sim.environment import client_environment
from orbitfb.sim.job import SimJob

pytestmark = pytest.mark.system


def job(port, **sim):
    return SimJob.model_validate({"sim": {"port": port, "interface": "127.0.0.1"} | sim})


def wait_until_gone(pid, seconds=3.0):
    end = time.monotonic() + seconds
    while psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < end, "the process is still there"
        time.sleep(0.02)


def test_a_second_one_on_the_same_port_refuses():
    with serving() as child:
        second = SimChild(job(child.port))
        with pytest.raises(OwnershipError, match=f"port {child.port} on 127.0.0.1 is in use"):
            second.start()
        assert not second.alive
        with RawClient(child.port) as client:
            client.create(TICK)
            assert client.get(TICK).value > 0


@pytest.mark.parametrize(
    "kind", [pytest.param(socket.SOCK_DGRAM, marks=pytest.mark.nightly), socket.SOCK_STREAM]
)
def test_either_protocol_taken_by_somebody_else_is_refused(kind):
    with socket.socket(socket.AF_INET, kind) as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if kind == socket.SOCK_DGRAM:
            other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        other.bind(("0.0.0.0", 0))
        if kind == socket.SOCK_STREAM:
            other.listen()
        with pytest.raises(OwnershipError, match="in use"):
            SimChild(job(other.getsockname()[1])).start()


def test_a_wrong_ring_or_interface_is_told():
    with pytest.raises(MachineError, match=r"nowhere\.csv"):
        SimChild(SimJob.model_validate({"places": "/nowhere.csv", "sim": {"port": 0}})).start()
    with pytest.raises(OwnershipError, match="interface"):
        SimChild(job(0, interface="203.0.113.1")).start()


@pytest.mark.timing
@pytest.mark.parametrize(
    "number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.nightly)]
)
@pytest.mark.parametrize("plain", [False, True])
def test_signals_end_it_cleanly_with_clients_on(number, plain):
    with (
        serving(rate_hz=10 if plain else 100, plain=plain) as child,
        RawClient(child.port) as client,
    ):
        client.create(*READINGS)
        client.subscribe(*READINGS)
        client.frame()
        begin = time.monotonic()
        os.kill(child.pid, number)
        process = child._started
        assert process.wait(5) == 0, child.last_words()
        assert time.monotonic() - begin < 1.0
        assert child.last_words() == ""
        with pytest.raises(ConnectionError):
            while True:
                client.receive()


def test_after_kill_9_it_is_back_at_once_on_the_same_port():
    with serving(rate_hz=50) as first:
        port = first.port
        clients = [RawClient(port) for _ in range(3)]
        for client in clients:
            client.create(*READINGS)
            client.subscribe(*READINGS)
        os.kill(first.pid, signal.SIGKILL)
        first._started.wait()
        again = SimChild(job(port))
        try:
            assert again.start() == port
            with RawClient(port) as client:
                client.create(TICK)
                assert client.get(TICK).value > 0
        finally:
            again.stop()
            for client in clients:
                client.socket.close()


def test_it_does_not_outlive_a_parent_that_is_killed():
    script = """
        import sys, time
        from orbitfb.sim.child import SimChild
        from orbitfb.sim.job import SimJob
        child = SimChild(SimJob.model_validate({"sim": {"port": 0}}))
        child.start()
        print(child.pid, child.port, flush=True)
        time.sleep(60)
    """
    with subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(script)], stdout=subprocess.PIPE, text=True
    ) as parent:
        pid, port = map(int, parent.stdout.readline().split())
        assert psutil.pid_exists(pid)
        assert os.getpgid(pid) != os.getpgid(parent.pid)
        parent.kill()
        wait_until_gone(pid)
    with socket.socket() as probe, pytest.raises(ConnectionRefusedError):
        probe.connect(("127.0.0.1", port))


def test_a_child_is_started_once_and_stopped_for_good():
    child = SimChild(job(0))
    with pytest.raises(MachineError, match="start"):
        _ = child.port
    port = child.start()
    with pytest.raises(OwnershipError, match="runs already"):
        child.start()
    assert child.environment() == client_environment(port)
    pid = child.pid
    child.stop()
    child.stop()
    assert not child.alive and not psutil.pid_exists(pid)


def test_it_speaks_on_loopback_only_and_not_on_the_production_port():
    with serving() as child:
        sockets = psutil.Process(child.pid).net_connections("inet")
        assert {s.laddr.ip for s in sockets} == {"127.0.0.1"}
        assert {s.raddr.ip for s in sockets if s.raddr} <= {"127.0.0.1"}
        assert 5064 not in {s.laddr.port for s in sockets}


@pytest.mark.parametrize("text", ["", "{", '{"sim": {"prot": 1}}'])
def test_a_wrong_job_is_refused(text):
    done = subprocess.run(
        [sys.executable, "-m", "orbitfb.sim"],
        input=text + "\n",
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    assert done.returncode == 2 and not done.stdout
    assert "job" in done.stderr and "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("planes", "bpms"), [pytest.param("y", 180, marks=pytest.mark.nightly), ("xy", 360)]
)
def test_either_plane_or_both_are_served(planes, bpms):
    job_of_planes = SimJob.model_validate({"planes": planes, "sim": {"port": 0}})
    channels = Ring.load().channels(planes)
    assert len(channels.orbit_pvs) == bpms
    with SimChild(job_of_planes) as child, RawClient(child.port) as client:
        client.create(*channels.orbit_pvs, *channels.setpoint_pvs, *channels.readback_pvs)
        assert client.get(channels.orbit_pvs[-1]).value != 0.0
