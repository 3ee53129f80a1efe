"""The kick experiment through Channel Access, short; and the knob that kicks."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from orbitfb.core.errors import ConnectError
from orbitfb.epics.knob import Knob
from orbitfb.epics.machine import EpicsMachine
from orbitfb.epics.settings import AuxiliarySettings, EpicsSettings
from orbitfb.physics.places import Ring
from orbitfb.sim.child import SimChild
from orbitfb.sim.job import SimJob
from orbitfb.sim.layout import KICK_PV, TRUE_RMS_PV
from orbitfb.sim.settings import SimSettings

pytestmark = pytest.mark.system


def test_the_knob_kicks_the_ring():
    job = SimJob(plant={"initial_orbit_rms": 0.0}, sim=SimSettings(port=0, rate_hz=50.0))
    with SimChild(job) as child:
        true_rms = {"true": AuxiliarySettings(pv=TRUE_RMS_PV, scale=1e-3)}
        network = EpicsSettings(server_port=child.port, auxiliary=true_rms)
        channels = Ring.load().channels("x")
        with EpicsMachine(channels, network) as machine, Knob(KICK_PV, network) as knob:
            for _ in range(5):
                machine.read(2.0)
            assert machine.read(2.0).auxiliary["true"] < 1e-6
            knob.turn(0.1)
            seen = [machine.read(2.0).auxiliary["true"] for _ in range(10)]
    assert seen[-1] == pytest.approx(0.1e-3, rel=0.02)


def test_a_knob_that_nobody_serves_is_named(dead_port):
    network = EpicsSettings(server_port=dead_port, connect_timeout=0.3)
    with pytest.raises(ConnectError, match="Kick-SP"):
        Knob(KICK_PV, network)


@pytest.mark.timeout(180)
def test_the_command_measures_recoveries(tmp_path):
    done = subprocess.run(
        [
            *(sys.executable, "-m", "orbitfb", "evaluate", "kick", "--out", str(tmp_path / "out")),
            *("--law", "svd", "--law", "network", "--law", "told-network"),
            *("--kicks", "2", "--window", "50", "--settle", "100", "--rate", "40", "--seed", "3"),
        ],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=150,
        check=False,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr
    document = json.loads((tmp_path / "out" / "kick.json").read_text())
    assert document["seed"] == 3 and document["wrong"]["relative_error"] > 0.02
    laws = document["laws"]
    for law in ("svd", "network", "told-network"):
        assert laws[law]["recovered"] == 2.0, laws[law]
        assert laws[law]["kick"] == pytest.approx(250e-6, rel=0.02)
        assert np.array(laws[law]["courses_m"]).shape == (2, 40)
    # half of the orbit per tick against all of it
    assert laws["svd"]["steps_to_near"] >= 3
    assert laws["told-network"]["steps_to_near"] < laws["svd"]["steps_to_near"]
    assert laws["network"]["steps_to_near"] < laws["svd"]["steps_to_near"]
    assert "| SVD on the wrong R, frozen | 2 of 2 |" in done.stdout
    assert (tmp_path / "out" / "kick.png").read_bytes().startswith(b"\x89PNG")


def test_a_law_that_nobody_knows_is_refused(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "orbitfb", "evaluate", "kick", "--out", "nowhere", "--law", "x"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2 and "--laws-0" in done.stderr
