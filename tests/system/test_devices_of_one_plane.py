"""A ring whose correctors act in one plane each: run, panel, refit, archive."""

from pathlib import Path

import pytest
from service_process import Service, transitions
from single_planes import write_ring
from test_panel import PREFIX, operate

from orbitfb.control.client import ask

pytestmark = pytest.mark.system


@pytest.fixture
def service(tmp_path: Path):
    places, parameters = write_ring(tmp_path)
    file = tmp_path / "c.toml"
    file.write_text(
        f"""
        [ring]
        planes = "xy"
        places = "{places}"
        parameters = "{parameters}"
        [policy.svd.planes.y]
        singular_values = 80
        [panel]
        enabled = true
        port = 0
        period = 0.1
        prefix = "{PREFIX}"
        """
    )
    with Service(tmp_path / "data", "sim", "--rate", 20, "--config", file, learn=True) as service:
        yield service


@pytest.mark.nightly
def test_a_loop_runs_is_seen_and_refits_and_its_archive_is_read(service: Service):
    service.wait_state("CLOSED")
    seen = operate(
        service,
        """
        until(lambda: text("State-I") == "CLOSED", "CLOSED")
        until(lambda: get("RmsX-I") < 5 and get("RmsY-I") < 10, "a good orbit")
        finish({
            "orbit": [len(get("OrbitX-I")), len(get("OrbitY-I"))],
            "setpoint": [len(get("SetpointX-I")), len(get("SetpointY-I"))],
            "enable": [len(get("BpmEnable-RB")), len(get("CorrectorEnable-RB"))],
            "modes": [get("ModesX-RB"), get("ModesY-RB")],
            "first_of_y": list(get("CorrectorNameY-I"))[0],
        })
        """,
    )
    assert seen["orbit"] == [180, 179] and seen["setpoint"] == [90, 105]
    assert seen["enable"] == [359, 195] and seen["modes"] == [90, 80]
    assert seen["first_of_y"] == "CH1A_C30V"
    off = [number != 90 for number in range(195)]  # the first corrector of y
    assert ask(service.data, {"command": "enable-correctors", "enabled": off})["correctors"] == 194
    ticks = service.status()["ticks"]
    service.wait_status("ticks", lambda its: its["ticks"] > ticks + 60, 60.0)
    report = ask(service.data, {"command": "refit"}, timeout=60.0)
    assert report["decision"] in ("promoted", "refused"), report
    assert service.status()["state"] == "CLOSED"
    service.stop()
    assert (service.data / "operator.json").read_text().count("CH1A_C30V:y") == 1
    read = transitions(service.data)
    assert read.orbit.shape[1] == 359 and read.setpoints.shape[1] == 195
