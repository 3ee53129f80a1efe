"""What the tutorial First run says of the ring that drifts, by the numbers it gives."""

import json
from concurrent.futures import ThreadPoolExecutor

import pytest
from service_process import orbitfb

pytestmark = [pytest.mark.system, pytest.mark.nightly, pytest.mark.timing]
DRIFTING = ("--drift", "strong", "--drift-ticks", "300", "--duration", "60", "--port", "0")


def true_orbit(folder, learning):
    """The true orbit over the last 10 s of the tutorial's minute, rms [µm]."""
    file = folder / f"{learning}.json"
    data = folder / f"data-{learning}"
    options = ("--metrics-port", "0", "--data", data, "--summary", file)
    environment = {"ORBITFB_LEARN__ENABLED": learning, "ORBITFB_WEB__ENABLED": "false"}
    done = orbitfb("run", "--ioc", "sim", *DRIFTING, *options, **environment)
    assert done.returncode == 0, done.stderr
    return json.loads(file.read_text())["orbit_rms_um"]["true_last_10s"]


def test_the_orbit_ends_where_the_tutorial_says_with_learning_and_without(tmp_path):
    with ThreadPoolExecutor() as both:
        ends = list(both.map(lambda learning: true_orbit(tmp_path, learning), ("true", "false")))
    assert all(3.0 < end < 4.0 for end in ends)
