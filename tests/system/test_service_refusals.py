"""What cannot be done is refused: what, where, what to do; no traceback, nothing left running."""

import json
import os
import re
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from service_process import CHANNELS, PROGRAM, Ioc, Service, lean, orbitfb, read_log, refused

from orbitfb.core.errors import MOST_SHOWN
from orbitfb.physics.places import Ring

pytestmark = pytest.mark.system

RUN = ("run", "--metrics-port", 0, "--duration", 1)
SIM = (*RUN, "--ioc", "sim", "--port", 0)


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("refusals")


@pytest.fixture(scope="module")
def ring(directory: Path) -> Iterator[Ioc]:
    with Ioc(directory) as ioc:
        yield ioc


@pytest.fixture(scope="module")
def service(ring: Ioc, directory: Path) -> Iterator[Service]:
    """A loop that is there first."""
    with Service(directory / "first", f"127.0.0.1:{ring.port}") as first:
        first.wait_state("OPEN")
        yield first


def test_port_of_the_ring_in_use(taken_port: int, tmp_path: Path):
    data = ("--data", tmp_path / "data")
    said = refused(*RUN, "--ioc", "sim", "--port", taken_port, *data)
    assert said == (
        f"the soft IOC did not start: port {taken_port} on 127.0.0.1 is in use, by another IOC "
        "perhaps; stop that one or choose another sim.port (0 takes any free one)"
    )
    [line] = read_log(tmp_path / "data")
    assert (line["event"], line["level"], line["problem"]) == ("start_failed", "error", said)


def test_port_of_an_ioc_alone_in_use(taken_port: int):
    said = refused("ioc", "--port", taken_port)
    assert said.startswith(f"port {taken_port} on 127.0.0.1 is in use, by another IOC perhaps;")


def test_port_of_the_metrics_in_use_does_not_stop_control(taken_port: int, tmp_path: Path):
    data = tmp_path / "data"
    done = orbitfb(*SIM[:1], *SIM[3:], "--metrics-port", taken_port, "--data", data)
    problem = (
        f"metrics and health: 127.0.0.1 port {taken_port} is in use: is another orbitfb running? "
        "Set observe.host and observe.port (--metrics-port; 0 takes any free one), or "
        "observe.enabled = false"
    )
    assert done.returncode == 0 and f"no metrics as yet: {problem}\n" in done.stdout
    events = {line["event"]: line for line in read_log(data)}
    assert events["metrics_not_served"]["problem"] == problem
    assert events["service_stopped"]["state"] == "CLOSED"


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_a_second_loop_on_one_ring(service: Service, host: str, tmp_path: Path):
    said = refused(*RUN, "--ioc", f"{host}:{service.port}", "--data", tmp_path / "data")
    assert said == (
        f"the ring at {host}, port {service.port}, plane x is held by another orbitfb (process "
        f"{service.popen.pid}); two loops on one ring fight each other; stop the other one first"
    )
    assert service.status()["state"] == "OPEN"


def test_a_second_loop_found_through_the_environment(service: Service, tmp_path: Path):
    said = refused(
        *(*RUN, "--ioc", "env", "--data", tmp_path / "data"),
        EPICS_CA_ADDR_LIST="127.0.0.1",
        EPICS_CA_SERVER_PORT=str(service.port),
    )
    assert f"is held by another orbitfb (process {service.popen.pid})" in said


@pytest.mark.nightly
def test_a_second_loop_on_one_plane_of_two(tmp_path: Path):
    """Whoever has both planes has each of them."""
    with (
        Ioc(tmp_path, 0, ("--planes", "xy")) as both,
        Service(tmp_path / "xy", f"127.0.0.1:{both.port}", "--planes", "xy"),
    ):
        options = ("--planes", "y", "--data", tmp_path / "y")
        said = refused(*RUN, "--ioc", f"127.0.0.1:{both.port}", *options)
        assert f"the ring at 127.0.0.1, port {both.port}, plane y is held by another" in said


def test_a_second_service_on_one_data_directory(service: Service, dead_port: int):
    data = service.data
    names = ((data, data), (data.parent / "x" / ".." / data.name, data))
    for name, _ in names:
        (data.parent / "x").mkdir(exist_ok=True)
        said = refused(*RUN, "--ioc", f"127.0.0.1:{dead_port}", "--data", name)
        assert said == (
            f"the data directory {name} is held by another orbitfb (process {service.popen.pid}); "
            "stop it, or name another directory with --data"
        )
    assert service.status()["state"] == "OPEN"


def test_pvs_of_another_plane_are_counted_all_at_once(ring: Ioc, tmp_path: Path):
    options = ("--planes", "y", "--data", tmp_path / "data")
    environment = {"ORBITFB_EPICS__CONNECT_TIMEOUT": "5.0"}
    said = refused(*RUN, "--ioc", f"127.0.0.1:{ring.port}", *options, process=True, **environment)
    first, *names, advice = said.splitlines()
    assert first == "540 of 542 PVs did not connect within 5.0 s:"
    y = Ring.load().channels("y")
    shown = [*y.orbit_pvs[:MOST_SHOWN], f"… and {540 - MOST_SHOWN} more"]
    assert [name.strip() for name in names] == shown
    assert advice == (
        f"Is the IOC running, and reachable at '127.0.0.1' port {ring.port}? Are the names right "
        "(the places table)? `orbitfb doctor` with the same --ioc and --config counts them by kind."
    )


def test_nobody_at_the_port(dead_port: int, tmp_path: Path):
    environment = {"ORBITFB_EPICS__CONNECT_TIMEOUT": "1.0"}
    said = refused(
        *RUN,
        "--ioc",
        f"127.0.0.1:{dead_port}",
        "--data",
        tmp_path / "data",
        process=True,
        **environment,
    )
    assert said.startswith("542 of 542 PVs did not connect within 1.0 s:\n")
    assert CHANNELS.orbit_pvs[0] in said and len(said.splitlines()) < 24
    assert "(the places table and epics.auxiliary" in said  # and those of the RF
    assert not (tmp_path / "data/policies").exists()


@pytest.mark.parametrize("below", [False, True])
def test_data_directory_is_a_file(tmp_path: Path, below: bool):
    (tmp_path / "file").write_text("mine")
    data = tmp_path / "file" / "data" if below else tmp_path / "file"
    problem = "Not a directory" if below else "there is a file of that name"
    assert refused(*SIM, "--data", data) == (
        f"data_directory {data} cannot be used ({problem}); name another with --data"
    )
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize(
    ("place", "problem"),
    [("file/summary.json", "Not a directory"), ("directory", "Is a directory")],
)
def test_summary_cannot_be_written(place: str, problem: str, tmp_path: Path):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "directory").mkdir()
    path = tmp_path / place
    assert refused(*SIM, "--data", tmp_path / "data", "--summary", path) == (
        f"the summary cannot be written to {path}: {problem}; name a file in a directory that can "
        "be written to"
    )
    assert not (tmp_path / "data").exists()


def test_run_time_directory_cannot_be_used(tmp_path: Path):
    (tmp_path / "file").write_text("")
    for arguments in (SIM, ("command", "status"), ("policies", "activate", "x")):
        said = refused(
            *arguments, "--data", tmp_path / "data", XDG_RUNTIME_DIR=str(tmp_path / "file")
        )
        assert re.fullmatch(
            rf"{tmp_path}/file/orbitfb-\d+, for locks and the control socket, cannot be made "
            r"\(Not a directory\); set XDG_RUNTIME_DIR to a directory of your own, or unset it",
            said,
        )


@pytest.mark.nightly
def test_it_runs_without_home_and_run_time_directory(tmp_path: Path):
    done = orbitfb(
        *(*SIM, "--data", tmp_path / "data"),
        HOME=None,
        XDG_RUNTIME_DIR=None,
        TMPDIR=str(tmp_path),
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_places_table_is_refused_before_anything_starts(tmp_path: Path):
    (tmp_path / "places.csv").write_text("name,kind\n")
    (tmp_path / "c.toml").write_text(f'[ring]\nplaces = "{tmp_path}/places.csv"\n')
    for arguments in (SIM, ("ioc", "--port", 0)):
        data = ("--data", tmp_path / "data") if arguments is SIM else ()
        said = refused(*arguments, *data, "--config", tmp_path / "c.toml")
        assert said.startswith(f"{tmp_path}/places.csv, line 1: column s_m, beta_x_m, ")
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize("name", ["open", "status"])
def test_nobody_to_command(name: str, tmp_path: Path):
    said = refused("command", name, "--data", tmp_path)
    assert said.startswith(
        f"no service of this user runs on {tmp_path}; start one with `orbitfb run`, name its "
        "directory with --data, or give this shell the service's XDG_RUNTIME_DIR"
    )
    assert list(tmp_path.iterdir()) == []


def test_refit_of_nobody(tmp_path: Path):
    assert refused("refit", "--data", tmp_path).startswith("no service of this user runs on ")


def lean_here() -> dict[str, str]:
    return os.environ | lean(["run"])


@pytest.mark.parametrize("lines", [0, pytest.param(1, marks=pytest.mark.nightly)])
def test_a_closed_terminal_does_not_stop_the_loop(tmp_path: Path, lines: int):
    """`orbitfb run | head -1`: whoever read has gone, before the first line or after it."""
    command = [*PROGRAM, *map(str, SIM[:3]), "--ioc", "sim", "--port", "0", "--duration", "2.5"]
    summary = tmp_path / "s.json"
    options = ["--data", str(tmp_path / "data"), "--summary", str(summary)]
    with subprocess.Popen([*command, *options], stdout=subprocess.PIPE, env=lean_here()) as run:
        assert run.stdout is not None
        for _ in range(lines):
            run.stdout.readline()
        run.stdout.close()
        assert run.wait(60) == 0
    assert json.loads(summary.read_text())["ticks"] > 15


def test_a_hangup_leaves_no_child(tmp_path: Path, request: pytest.FixtureRequest):
    """The window is closed: the service stops in good order; its ring and its trainer go too."""
    # A session under nohup ignores the signal, and so would what it starts.
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    request.addfinalizer(lambda: signal.signal(signal.SIGHUP, before))
    with Service(tmp_path / "data", "sim", learn=True) as service:
        children = [service.child(module) for module in ("orbitfb.sim", "orbitfb.learn")]
        service.popen.send_signal(signal.SIGHUP)
        assert service.popen.wait(20.0) == 0
        assert read_log(service.data)[-1]["event"] == "service_stopped"
        for child in children:
            child.wait(20.0)


def test_ioc_alone_stops_cleanly(tmp_path: Path):
    for number in (signal.SIGINT, signal.SIGTERM):
        with Ioc(tmp_path) as ioc:
            assert ioc.stop(number) < 2.0
            assert (ioc.popen.returncode, ioc.err) == (0, "")
