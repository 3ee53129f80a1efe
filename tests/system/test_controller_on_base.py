"""The whole controller runs unchanged against an IOC of EPICS base."""

import json
import subprocess
import sys

import pytest
from base_ioc_process import BaseIoc

from orbitfb.physics.places import Ring

pytestmark = [pytest.mark.system, pytest.mark.nightly]  # fifteen seconds of a loop


def test_the_loop_closes_on_an_ioc_of_epics_base(tmp_path):
    channels = Ring.load().channels("x")
    summary = tmp_path / "summary.json"
    # The last 10 s begin when it has closed and its ramp is over; meanwhile it asks whether the
    # ring answers, by 0.5 µm or so.
    with BaseIoc(channels, rate_hz=10.0, plant_seed=3) as ioc:
        subprocess.run(
            [
                *(sys.executable, "-m", "orbitfb", "run", "--ioc", f"127.0.0.1:{ioc.port}"),
                *("--start", "closed", "--duration", "15", "--metrics-port", "0"),
                *("--data", str(tmp_path / "data"), "--summary", str(summary)),
            ],
            check=True,
            timeout=60,
            stdout=subprocess.DEVNULL,
        )
    figures = json.loads(summary.read_text())
    assert figures["state"] == "CLOSED"
    assert figures["orbit_rms_um"]["first"] == pytest.approx(250, rel=0.02)
    assert figures["orbit_rms_um"]["last_10s"] < 1.0
