"""Every PV that the files of the control room name answers; a trip is an alarm; health is asked."""

import json
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from ioc_clients import KICK, run_client
from service_process import Service, orbitfb
from typer.testing import CliRunner

from orbitfb.cli.app import app
from orbitfb.control.client import ask
from orbitfb.panel.settings import PanelSettings

pytestmark = pytest.mark.system

EPICS = Path(__file__).parents[2] / "deploy/epics"


def named_pvs() -> dict[str, set[str]]:
    """PVs by the file that names them, macros written out."""
    found: dict[str, set[str]] = {}
    for screen in ("overview.bob", "expert.bob", "orbit_x.bob"):
        root = ElementTree.parse(EPICS / screen).getroot()
        prefix = root.findtext("macros/P")
        texts = [its.text or "" for tag in ("pv_name", "x_pv", "y_pv") for its in root.iter(tag)]
        found[screen] = {
            text.replace("$(P)", prefix) for text in texts if text and text != "$(pv_name)"
        }
    tree = ElementTree.parse(EPICS / "alarms.xml").getroot()
    found["alarms.xml"] = {pv.get("name", "") for pv in tree.iter("pv")}
    archived = json.loads((EPICS / "archiver.json").read_text())
    found["archiver.json"] = {entry["pv"] for entry in archived}
    return found


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A service as the files expect it: the panel with its usual prefix."""
    directory = tmp_path_factory.mktemp("site")
    config = directory / "config.toml"
    config.write_text("[panel]\nenabled = true\nport = 0\nperiod = 0.1\n")
    with Service(directory / "data", "sim", "--start", "open", "--config", config) as service:
        yield service


def at_panel(service: Service, script: str) -> Any:
    return run_client(int(service.where["panel"].split(":")[1]), script)


def test_every_pv_in_every_file_answers(service: Service):
    named = named_pvs()
    files = {"overview.bob", "expert.bob", "orbit_x.bob", "alarms.xml", "archiver.json"}
    assert {file for file, pvs in named.items() if len(pvs) >= 4} == files  # none is read as empty
    everything = sorted(set().union(*named.values()))
    missing = at_panel(
        service,
        f"""
        import json, os
        import epics
        names = {everything!r}
        pvs = [epics.PV(name, auto_monitor=False) for name in names]
        print(json.dumps([pv.pvname for pv in pvs if not pv.wait_for_connection(timeout=10.0)
                          or pv.get(timeout=5.0) is None]), flush=True)
        os._exit(0)
        """,
    )
    assert missing == []


def port_of(service: Service) -> str:
    return service.where["metrics"].rpartition(":")[2]


def health(port: str, *options: str) -> tuple[int, str]:
    """Run the command in this process; gives its exit code and what it printed."""
    done = CliRunner().invoke(app, ["health", "--port", port, *options])
    return done.exit_code, done.output


def test_health_says_that_it_is_well(service: Service):
    service.wait_state("OPEN")
    for options, word in (((), "alive: OPEN, last"), (("--ready",), "ready: OPEN, last")):
        code, said = health(port_of(service), *options)
        assert code == 0 and said.startswith(word)
    done = orbitfb("health", "--json", ORBITFB_OBSERVE__PORT=port_of(service))
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["state"] == "OPEN"


def test_a_trip_is_a_major_alarm_and_health_tells_ready_from_alive(service: Service):
    ask(service.data, {"command": "close"})
    service.wait_state("CLOSED")
    run_client(
        service.port,
        f"""
        import epics
        epics.caput({KICK!r}, 5.0, wait=True, timeout=5.0)
        print(0, flush=True)
        import os; os._exit(0)
        """,
    )
    service.wait_state("TRIPPED")
    name = PanelSettings().prefix + "State-I"
    script = f"""
        import json, os, time
        import epics
        pv = epics.PV({name!r}, form="time")
        end = time.monotonic() + 10.0
        while pv.get(as_string=True, use_monitor=False) != "TRIPPED" and time.monotonic() < end:
            time.sleep(0.05)
        pv.get_timevars()
        print(json.dumps([pv.get(as_string=True), pv.severity]), flush=True)
        os._exit(0)
        """
    assert at_panel(service, script) == ["TRIPPED", 2]
    assert health(port_of(service))[0] == 0
    code, said = health(port_of(service), "--ready")
    assert code == 1 and said.startswith("not ready: TRIPPED: ")


def test_health_of_a_service_that_hangs_or_is_gone(service: Service):
    port = port_of(service)
    service.popen.send_signal(signal.SIGSTOP)
    try:
        code, said = health(port, "--timeout", "0.5")
    finally:
        service.popen.send_signal(signal.SIGCONT)
    assert code == 1 and said.startswith("not alive: no answer from 127.0.0.1")
    service.stop()
    code, said = health(port)
    assert code == 1 and said.startswith("not alive: no answer from 127.0.0.1")
