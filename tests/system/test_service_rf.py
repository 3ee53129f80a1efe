"""The RF frequency follows an energy that drifts, over Channel Access, and is let go in time."""

import csv
import json
import time
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ioc_clients import quick_ring, run_client
from service_process import Service, orbitfb, refused, wait_for

from orbitfb.control.client import ask
from orbitfb.core.errors import ControlError
from orbitfb.physics.frequency import frequency_model
from orbitfb.physics.places import Ring

pytestmark = pytest.mark.system

RATE = 2e-6
RING = Ring.load()
MODEL = frequency_model(RING, "x")
RUN = ("run", "--port", 0, "--metrics-port", 0)


def at(port: int, script: str) -> Any:
    return run_client(port, "import epics, json, os, time\n" + script + "\nos._exit(0)\n")


def panel(service: Service, *names: str) -> list[Any]:
    port = int(service.where["panel"].split(":")[1])
    known = [f"SR:FB{{Orbit}}{name}" for name in names]
    return at(
        port,
        f"print(json.dumps([epics.caget(n, as_string=n.endswith(('State-I', 'Reason-I'))) "
        f"for n in {known!r}]), flush=True)",
    )


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A closed loop under an energy ramp; the tests are one story, in order."""
    directory = tmp_path_factory.mktemp("rf")
    config = directory / "config.toml"
    config.write_text("[panel]\nenabled = true\nport = 0\nperiod = 0.1\n")
    options = ("--effect", f"energy-ramp:rate={RATE}", "--config", config)
    with Service(directory / "data", "sim", *options, learn=True) as service:
        yield service


def test_the_frequency_follows_and_the_correctors_do_not(service: Service):
    service.wait_state("CLOSED")
    wait_for("five steps", lambda: panel(service, "RfSteps-I")[0] >= 5)
    seen = at(
        service.port,
        """
        sp = epics.caget("RF{Osc:1}Freq:SP")
        print(json.dumps([sp, epics.caget("RF{Osc:1}Freq:I")]), flush=True)
        """.replace("\n        ", "\n"),
    )
    assert seen[0] == pytest.approx(seen[1], abs=1.0)
    moved = seen[0] - RING.rf_frequency
    assert moved * MODEL.per_hertz < -1e-6  # against the ramp
    state, energy, step = panel(service, "RfState-I", "RfEnergy-I", "RfStep-I")
    assert state == "FOLLOWS" and abs(energy) < 8.0 and 0.0 < abs(step) <= 1.0
    assert panel(service, "RfColumn-I") == [1.0]
    assert [line["steps"] for line in service.events("rf_stepped")] != []


@pytest.mark.nightly
def test_a_refit_tells_the_column_that_it_found(service: Service):
    """The ring is as its table says: the interval is narrower than what was stated, about 1."""
    wait_for("twenty steps", lambda: panel(service, "RfSteps-I")[0] >= 20)

    def found() -> dict[str, Any] | None:
        """A refit that has rows to tell from: where R̂ has started again it has none yet."""
        report = ask(service.data, {"command": "refit", "activate": False}, timeout=60.0)
        figures = report["figures"]
        sigma = (figures["rf_ratio_high"] - figures["rf_ratio_low"]) / 3.92
        assert abs(figures["rf_ratio"] - 1.0) < 4.0 * sigma
        return report if sigma < 0.1 else None

    report = wait_for("a refit that knows the column", found, 60.0)
    assert report["figures"]["rf_steps"] > 0 and "RF column" in report["reason"]
    wait_for(
        "it on the panel", lambda: panel(service, "RfFoundLow-I", "RfFoundHigh-I") != [None] * 2
    )
    low, high = panel(service, "RfFoundLow-I", "RfFoundHigh-I")
    assert 0.5 < low < high < 1.5


@pytest.mark.nightly
def test_a_refit_from_the_archive_tells_it_too(service: Service, tmp_path: Path):
    archive = service.data / "archive"
    done = orbitfb("refit", "--data", tmp_path, "--from", archive, "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["figures"]["rf_steps"] >= 10 and "RF column" in report["reason"]
    assert 0.8 < report["figures"]["rf_ratio"] < 1.2


def test_somebody_else_sets_the_frequency_and_has_it(service: Service):
    at(
        service.port,
        "epics.caput('RF{Osc:1}Freq:SP', 499680600.0, wait=True); print(0, flush=True)",
    )
    wait_for("STOPPED", lambda: panel(service, "RfState-I") == ["STOPPED"])
    [reason] = panel(service, "RfReason-I")
    assert "somebody else sets RF{Osc:1}Freq:SP" in reason
    assert service.status()["state"] == "CLOSED"
    time.sleep(2.0)
    there = at(service.port, "print(json.dumps(epics.caget('RF{Osc:1}Freq:SP')), flush=True)")
    assert there == 499680600.0
    [line] = service.events("rf_stopped")
    assert "somebody else" in line["reason"]


def test_by_command_it_follows_again_or_is_left_alone(service: Service):
    ask(service.data, {"command": "rf", "follow": True})
    wait_for("FOLLOWS", lambda: panel(service, "RfState-I") == ["FOLLOWS"])
    ask(service.data, {"command": "rf", "follow": False})
    wait_for("OFF", lambda: panel(service, "RfState-I") == ["OFF"])
    with pytest.raises(ControlError, match="follow must be true or false"):
        ask(service.data, {"command": "rf", "follow": "yes"})


def test_a_frequency_that_is_away_is_told_before_anything_moves(tmp_path: Path):
    with quick_ring() as ioc:
        places = ("--ioc", f"127.0.0.1:{ioc.port}", "--data", tmp_path / "data")
        said = refused(
            *RUN[:1],
            *RUN[3:],
            *places,
            ORBITFB_RF__ENABLED="true",
            ORBITFB_RF__SETPOINT_PV="RF{Osc:9}Freq:SP",
            ORBITFB_EPICS__CONNECT_TIMEOUT="5.0",
        )
        assert "RF{Osc:9}Freq:SP" in said and "rf.setpoint_pv" in said
        said = refused(
            *RUN[:1],
            *RUN[3:],
            *places,
            ORBITFB_RF__ENABLED="true",
            ORBITFB_RF__SETPOINT_PV="SR:SIM{Ring}Tick-I",
        )
        assert "the RF setpoint SR:SIM{Ring}Tick-I may not be written" in said
        currents = at(ioc.port, "print(epics.caget('SR:C30-MG{PS:CH1A}I:Sp1-SP'), flush=True)")
        assert currents == 0.0


def test_a_dispersion_of_the_wrong_sign_is_told_before_anything_moves(tmp_path: Path):
    text = (resources.files("orbitfb") / "data" / "places.csv").read_text(encoding="utf-8")
    rows = list(csv.DictReader(text.splitlines()))
    for row in rows:
        row["eta_x_m"] = str(-float(row["eta_x_m"]))
    places = tmp_path / "places.csv"
    with places.open("w", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    said = refused(
        *RUN,
        "--ioc",
        "sim",
        "--data",
        tmp_path / "data",
        ORBITFB_RING__PLACES=str(places),
        ORBITFB_RF__ENABLED="true",
    )
    assert "they have the same sign in every ring" in said
    assert np.mean([float(row["eta_x_m"]) for row in rows]) < 0
