"""`orbitfb measure-response` against a simulated ring that another process serves."""

import os
import pty
import shutil
import signal
import subprocess
import time

import numpy as np
import pytest
from service_process import (
    CHANNELS,
    PROGRAM,
    Ioc,
    Process,
    Service,
    orbitfb,
    refused,
    setpoints,
    wait_for,
)

from orbitfb.core.names import LEASE_PV
from orbitfb.measure.response_file import read_response
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.store.directory import PolicyStore

pytestmark = pytest.mark.system

MEASURED = (3, 40, 41, 100, 140, 179)
RATE = 100
BEFORE = np.zeros(180)
"""Setpoints of a ring that has just started; every test leaves them so."""


@pytest.fixture(scope="module")
def ring(tmp_path_factory):
    """A ring that all tests share: each must leave its setpoints as they were."""
    with Ioc(tmp_path_factory.mktemp("ring"), 0, ["--rate", RATE]) as ioc:
        yield ioc


@pytest.fixture
def config(tmp_path):
    """Few correctors, few orbits, to be quick."""
    masked = [name for j, name in enumerate(CHANNELS.correctors) if j not in MEASURED]
    file = tmp_path / "few.toml"
    quick = "[measure]\norbits = 2\nticks = 60\ncheck = 1\n[lease]\npv = ''\n"
    file.write_text(f"{quick}[masks]\ncorrectors = {masked!r}\n")
    return file


def arguments(ring, tmp_path, config, *more):
    return [
        "measure-response",
        "--ioc",
        f"127.0.0.1:{ring.port}",
        "--data",
        tmp_path / "data",
        "--config",
        config,
        "--rate",
        RATE,
        "--out",
        tmp_path / "response.safetensors",
        *more,
    ]


def apart(found):
    """How far a matrix is from that of the simulated ring, which has no drift."""
    true = response(Ring.load(), "x")[:, MEASURED]
    return np.linalg.norm(found.table.response[:, MEASURED] - true) / np.linalg.norm(true)


def begun(ring, tmp_path, config):
    """Start a measurement and wait until it has moved a corrector."""
    process = Process(arguments(ring, tmp_path, config), tmp_path, "measure")
    columns = tmp_path / "data/measurement/columns.safetensors"
    moved = tmp_path / "data/measurement/moved.json"
    wait_for("column", lambda: process.check_alive() or (columns.exists() and moved.exists()))
    return process


def test_it_refuses_beside_a_closed_loop(tmp_path, config):
    with Ioc(tmp_path, 0, ["--rate", 50]) as ring:
        place = f"127.0.0.1:{ring.port}"
        with Service(tmp_path / "loop", place, "--rate", 50, "--start", "closed") as service:
            service.wait_state("CLOSED")
            asked = arguments(ring, tmp_path, config)
            same = [tmp_path / "loop" if each == tmp_path / "data" else each for each in asked]
            told = refused(*same)
            # A busy machine holds a tick back.
            assert "is CLOSED" in told or "is HELD" in told, told
            # Another user, or another computer: no lock tells, but the lease does, and where there
            # is none, the setpoints move.
            (tmp_path / "elsewhere").mkdir(mode=0o700)
            there = {"XDG_RUNTIME_DIR": str(tmp_path / "elsewhere")}
            assert "is under the control of" in refused(*asked, **there, ORBITFB_LEASE__PV=LEASE_PV)
            done = orbitfb(*asked, **there)
            assert done.returncode == 2
            assert "somebody else moves them" in done.stderr
            service.wait_state("CLOSED")  # a busy computer may hold it for a moment
            entries = service.status()["state_entries"]
            assert entries["TRIPPED"] == entries["OPEN"] == 0
            service.stop()
    assert not (tmp_path / "response.safetensors").exists()


def test_the_matrix_is_the_rings_and_a_loop_runs_on_it(ring, tmp_path, config):
    done = orbitfb(*arguments(ring, tmp_path, config, "--at-once", 0))
    assert done.returncode == 0, (done.stdout, done.stderr)
    found = read_response(tmp_path / "response.safetensors", CHANNELS)
    assert apart(found) < 0.02
    asked = f"[ring]\nresponse = '{tmp_path}/response.safetensors'\n"
    config.write_text(asked + config.read_text())
    with Service(tmp_path / "loop", f"127.0.0.1:{ring.port}", "--config", config) as service:
        store = PolicyStore(tmp_path / "loop/policies")
        policy = store.load(service.where["policy"], CHANNELS)
        np.testing.assert_array_equal(
            policy.response[:, MEASURED], found.table.response[:, MEASURED]
        )
        service.stop()
    config.write_text(asked)
    place = ["--ioc", f"127.0.0.1:{ring.port}", "--data", tmp_path / "other"]
    told = refused("run", *place, "--config", config, "--metrics-port", 0)
    assert "is not adopted" in told and "was not measured" in told


@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.nightly)]
)
def test_an_aborted_matrix_measurement_leaves_no_trace(ring, tmp_path, config, number):
    with begun(ring, tmp_path, config) as process:
        process.stop(number)
        assert process.popen.returncode == 128 + number, process.err
        assert "the setpoints are back" in process.err
    np.testing.assert_array_equal(setpoints(ring.port), BEFORE)
    left = {file.name for file in tmp_path.rglob("*") if file.suffix in (".safetensors", ".json")}
    assert left == {"columns.safetensors"}  # to go on with; no matrix, no policy, nothing moved


@pytest.mark.nightly
def test_after_a_kill_the_next_start_offers_to_put_the_setpoints_back(ring, tmp_path, config):
    for _ in range(5):  # it may be hit before the first step of a corrector, or after the last
        with begun(ring, tmp_path, config) as process:
            time.sleep(0.05)
            process.kill()
        astray = np.flatnonzero(setpoints(ring.port))
        if astray.size:
            break
        shutil.rmtree(tmp_path / "data")
    assert astray.size == 1
    told = refused(*arguments(ring, tmp_path, config))  # nobody is there to be asked
    assert CHANNELS.setpoint_pvs[astray[0]] in told and "--restore" in told
    ours, theirs = pty.openpty()
    try:
        os.write(ours, b"y\n")
        done = subprocess.run(
            [*PROGRAM, *map(str, arguments(ring, tmp_path, config))],
            stdin=theirs,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
    finally:
        os.close(ours)
        os.close(theirs)
    assert done.returncode == 0, (done.stdout, done.stderr)
    assert "Put them back?" in done.stdout
    assert "1 setpoints are back" in done.stdout and "going on with" in done.stdout
    np.testing.assert_array_equal(setpoints(ring.port), BEFORE)
    found = read_response(tmp_path / "response.safetensors", CHANNELS)
    np.testing.assert_array_equal(np.flatnonzero(found.table.measured), MEASURED)
    assert apart(found) < 0.02
