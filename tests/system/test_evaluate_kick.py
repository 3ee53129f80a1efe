"""The kick experiment through Channel Access, short; and the knob that kicks."""

import json
import os
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from service_process import CONNECT, START

from orbitfb.core.errors import ConnectError
from orbitfb.epics.probe import Probe
from orbitfb.epics.settings import EpicsSettings
from orbitfb.sim.child import SimChild
from orbitfb.sim.job import SimJob
from orbitfb.sim.layout import KICK_PV, TICK_PV, TRUE_RMS_PV
from orbitfb.sim.settings import SimSettings

pytestmark = pytest.mark.system


def test_the_probe_kicks_the_ring_and_sees_every_tick():
    job = SimJob(
        plant={"initial_orbit_rms": 0.0, "ground_motion_rms": 0.0},
        sim=SimSettings(port=0, rate_hz=50.0),
    )
    seen: list[list[float]] = []
    far = threading.Event()

    def take(snapshot):
        seen.append(snapshot.values.tolist())
        if len(seen) >= 40:
            far.set()

    with SimChild(job) as child:
        network = EpicsSettings(server_port=child.port)
        with Probe((TICK_PV, TRUE_RMS_PV), KICK_PV, network, take) as probe:
            asked = seen[-1][0] if seen else 0
            probe.turn(0.1)
            assert far.wait(START)
        count = len(seen)
        time.sleep(0.1)
        assert len(seen) == count, "something was taken after the end"
    ticks, true_rms = np.array(seen).T
    np.testing.assert_array_equal(np.diff(ticks), 1)
    first = int(np.argmax(true_rms > 0))
    assert asked < ticks[first] and true_rms[first] > 0
    np.testing.assert_allclose(true_rms[first:], 0.1, rtol=1e-6)


def test_pvs_that_nobody_serves_are_named(dead_port):
    network = EpicsSettings(server_port=dead_port, connect_timeout=0.3)
    with pytest.raises(ConnectError, match="Kick-SP") as caught:
        Probe((TICK_PV,), KICK_PV, network, lambda _: None)
    assert set(caught.value.missing) == {TICK_PV, KICK_PV}


@pytest.mark.timing
@pytest.mark.nightly
def test_the_command_measures_recoveries(tmp_path):
    done = subprocess.run(
        [
            *(sys.executable, "-m", "orbitfb", "evaluate", "kick", "--out", str(tmp_path / "out")),
            *("--law", "svd", "--law", "network", "--law", "told-network"),
            *("--kicks", "3", "--window", "50", "--settle", "100", "--rate", "40", "--seed", "3"),
        ],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
        env={**os.environ, CONNECT: str(START)},
    )
    assert done.returncode == 0, done.stderr
    document = json.loads((tmp_path / "out" / "kick.json").read_text())
    assert document["seed"] == 3 and document["wrong"]["relative_error"] > 0.02
    fewest = {}
    for law, figures in document["laws"].items():
        assert figures["recovered"] == 3.0, figures
        assert figures["kick"] == pytest.approx(250e-6, rel=0.02)
        courses = np.array(figures["courses_m"])
        assert courses.shape == (3, 40)
        # of the kick during which this computer stalled the least
        fewest[law] = np.argmax(courses <= 50e-6, axis=1).min()
    # half of the orbit per tick against all of it
    assert fewest["svd"] >= 3
    assert fewest["told-network"] < fewest["svd"]
    assert fewest["network"] < fewest["svd"]
    assert "| SVD on the wrong R, frozen | 3 of 3 |" in done.stdout
    assert (tmp_path / "out" / "kick.png").read_bytes().startswith(b"\x89PNG")


def test_a_law_that_nobody_knows_is_refused(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "orbitfb", "evaluate", "kick", "--out", "nowhere", "--law", "x"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2 and "--law:" in done.stderr
