"""A running service that trips leaves a file from which anybody can tell why."""

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from ioc_clients import KICK, run_client
from service_process import Service, orbitfb, rms, wait_for

from orbitfb.control.client import ask
from orbitfb.postmortem.reading import read_postmortem
from orbitfb.sim.layout import STORED_PV

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A closed loop; the tests are one story, in order."""
    directory = tmp_path_factory.mktemp("postmortem")
    (directory / "c.toml").write_text("[postmortem]\nbefore = 1.2\nafter = 0.5\nkept_files = 2\n")
    with Service(directory / "data", "sim", "--config", directory / "c.toml") as running:
        running.wait_below(1.0)
        running.wait_status("ticks", lambda status: status["ticks"] > 32, 20.0)
        yield running


def put(service: Service, name: str, value: float) -> None:
    run_client(
        service.port,
        f"""
        from caproto.sync.client import write
        write({name!r}, [{value}], notify=True, repeater=False)
        print(1)
        """,
    )


def written(service: Service, count: int) -> Path:
    """Wait until that many are written, and give the last."""
    events = wait_for(
        "post-mortem",
        lambda: found if len(found := service.events("postmortem_written")) >= count else None,
    )
    return Path(events[count - 1]["path"])


def test_beam_loss_is_kept_and_told(service: Service, tmp_path: Path):
    put(service, STORED_PV, 0.0)
    tripped = service.wait_state("TRIPPED", 10.0)
    path = written(service, 1)
    assert path.parent == service.data / "postmortem"
    assert service.metric("orbitfb_postmortems_written_total") == 1
    assert service.metric("orbitfb_postmortems_failed_total") == 0
    its = read_postmortem(path)
    assert its.reason == tripped["reason"] and its.state == "TRIPPED"
    ticks, since = its.columns["tick"], its.columns["since_trip"]
    assert (np.diff(ticks) == 1).all()
    assert -1.21 < since[0] < -0.8 and 0.2 < since[-1] < 0.51
    trip = int(np.flatnonzero(ticks == its.about["tick"])[0])
    assert its.columns["auxiliary/current"][trip - 1] == pytest.approx(0.4)
    assert its.columns["auxiliary/current"][trip] == 0.0
    assert its.columns["applied"][trip - 1].any() and not its.columns["applied"][trip:].any()
    assert rms(its.columns["orbit"][trip - 1 : trip])[0] < 1e-6
    assert "before = 1.2" in its.configuration
    out = tmp_path / "trip.html"
    told = orbitfb("postmortem", "last", "--data", service.data, "--out", out)
    assert (told.returncode, told.stderr) == (0, "")
    assert f"reason: {tripped['reason']}\n" in told.stdout
    assert re.search(r"^stored current: 400 mA before, 0 mA at the trip", told.stdout, re.MULTILINE)
    assert out.read_text().startswith("<!doctype html>")


def test_an_orbit_that_leaves_is_kept_after_the_reset(service: Service, tmp_path: Path):
    put(service, STORED_PV, 400.0)
    wait_for("current", lambda: service.metric("orbitfb_stored_current_amperes") > 0.3)
    for name in ("reset", "close"):
        ask(service.data, {"command": name})
    service.wait_below(1.0)
    put(service, KICK, 3.0)
    reason = service.wait_state("TRIPPED", 10.0)["reason"]
    its = read_postmortem(written(service, 2))
    assert its.reason == reason and "orbit error" in reason
    arguments = ("postmortem", its.path, "--json", "--out", tmp_path / "x.png")
    answer = json.loads(orbitfb(*arguments).stdout)
    assert answer["orbit_rms"]["before"] < 1e-6 < 1e-4 < answer["orbit_rms"]["at"]
    assert answer["first_bpm"]["name"] in its.channels.bpms
    assert answer["first_bpm"]["since_trip"] > -1.0
    assert any("CLOSED → TRIPPED" in change["text"] for change in answer["changes"])


def test_one_on_request_and_the_oldest_goes(service: Service):
    first = written(service, 1)
    done = orbitfb("command", "postmortem", "--data", service.data, "--json")
    made = Path(json.loads(done.stdout)["postmortem"])
    assert read_postmortem(made).trigger == "command"
    [removed] = wait_for("removal", lambda: service.events("postmortems_removed"))
    assert removed["paths"] == [str(first)] and not first.exists()
    listed = orbitfb("postmortem", "--data", service.data).stdout.splitlines()
    assert len(listed) == 2 and "TRIPPED" in listed[0] and made.name in listed[1]
