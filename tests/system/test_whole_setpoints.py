"""Setpoint records that hold steps only: longout of EPICS base, and a ring whose records round."""

from pathlib import Path

import numpy as np
import pytest
from base_ioc_process import BaseIoc, small_ring
from service_process import CHANNELS, Service, setpoints, wait_for

from orbitfb.app.doctor.finding import Verdict
from orbitfb.app.doctor.ring import look_at_ring
from orbitfb.config.tree import AppConfig
from orbitfb.epics.machine import EpicsMachine
from orbitfb.epics.settings import EpicsSettings
from orbitfb.loop.machines.stepped import stepped
from orbitfb.physics.places import Ring

pytestmark = pytest.mark.system

STEP = 1e-3


def test_what_is_written_to_longouts_is_what_they_hold_and_the_rest_is_carried():
    with (
        BaseIoc(ring := small_ring(6), 20.0, setpoint_record="longout") as ioc,
        EpicsMachine(ring, EpicsSettings(server_port=ioc.port)) as inside,
    ):
        assert inside.steps.tolist() == [1.0] * 6
        machine = stepped(inside, inside.steps, 17.5, lambda: inside.drive_limits)
        for wanted, there in ((0.4, 0.0), (0.4, 1.0), (-3.7, -4.0), (17.5, 17.0)):
            machine.read(5.0)  # no write without an orbit
            sent = machine.write(np.full(6, wanted)).setpoints
            assert sent.tolist() == [there] * 6
            wait_for("puts", lambda sent=sent: np.array_equal(machine.setpoints(), sent))
        assert machine.read(5.0).by_others is None  # its own puts are known by what was sent
        last = sent.tolist()
        wait_for("readbacks", lambda: machine.read(5.0).readback.tolist() == last)


def test_the_doctor_tells_of_them():
    with BaseIoc(CHANNELS, 10.0, plant_seed=3, setpoint_record="longout") as ioc:
        found = look_at_ring(AppConfig(), Ring.load(), f"127.0.0.1:{ioc.port}", False, 20.0)
        told = {each.check: each for each in found}["setpoint records"]
    assert told.verdict is Verdict.WARNING
    assert told.told.startswith("180 of 180 setpoints hold steps only, of up to 1 A: ")
    assert "rounding alone moves the orbit by about 1.44e+03 µm rms" in told.told


def test_a_loop_on_records_that_round_stays_closed_and_sends_steps(tmp_path: Path):
    file = tmp_path / "c.toml"
    file.write_text(f"[epics]\nsetpoint_step = {STEP}\n")
    with Service(tmp_path / "data", "sim", "--config", file, "--rate", 20) as service:
        service.wait_state("CLOSED")
        service.wait_below(4.0)
        ticks = service.status()["ticks"]
        service.wait_status("ticks", lambda its: its["ticks"] > ticks + 100, 60.0)
        steps = setpoints(service.port) / STEP
        assert np.abs(steps - np.round(steps)).max() < 1e-6 and np.abs(steps).max() > 10
        status = service.status()
        assert status["state"] == "CLOSED" and status["state_entries"]["TRIPPED"] == 0
        assert "rounding alone moves the orbit by about 1.44 µm rms" in service.out
