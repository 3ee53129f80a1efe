"""Orbit, setpoints and readbacks as one PV each, over Channel Access: the loop, and bad arrays."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from base_ioc_process import BaseIoc, as_arrays, small_ring
from ioc_clients import run_client
from service_process import Service

from benchmarks.array_places import array_places
from orbitfb.control.client import ask
from orbitfb.core.errors import MachineError
from orbitfb.epics.machine import EpicsMachine
from orbitfb.epics.settings import EpicsSettings
from orbitfb.sim.child import SimChild
from orbitfb.sim.job import SimJob
from orbitfb.sim.settings import SimSettings

pytestmark = pytest.mark.system


def test_a_loop_closes_on_arrays_and_leaves_a_disabled_corrector_alone(tmp_path: Path):
    places = array_places(tmp_path / "places.csv")
    file = tmp_path / "c.toml"
    file.write_text(f'[ring]\nplaces = "{places}"\n')
    with Service(tmp_path / "data", "sim", "--config", file) as service:
        service.wait_state("CLOSED")
        service.wait_below(1.0)
        enabled = [index != 0 for index in range(180)]
        ask(service.data, {"command": "enable-correctors", "enabled": enabled})
        time.sleep(2.0)
        service.wait_below(1.0)
        assert service.status()["state"] == "CLOSED"


@pytest.fixture(scope="module")
def port(tmp_path_factory: pytest.TempPathFactory):
    places = array_places(tmp_path_factory.mktemp("arrays") / "places.csv")
    with SimChild(SimJob(places=places, sim=SimSettings(rate_hz=10.0, port=0))) as child:
        yield child.port


def test_other_clients_read_and_write_the_arrays_of_the_soft_ioc(port: int):
    count, sizes, back, refused, after = run_client(
        port,
        """
        import json, time
        from caproto.threading.client import Context
        context = Context()
        names = ["SR:Orbit{X}-I", "SR:Currents{X}-SP", "SR:Currents{X}-I"]
        orbit, setpoints, readbacks = context.get_pvs(*names)
        got = []
        def keep(sub, response): got.append(list(response.data))
        subscription = orbit.subscribe(data_type="time")
        subscription.add_callback(keep)
        wanted = [0.01 * index for index in range(180)]
        setpoints.write(wanted, wait=True)
        time.sleep(0.5)
        back = list(readbacks.read().data)
        refused = 0
        for bad in ([19.0] * 180, [0.1] * 179, [float("nan")] * 180):
            try:
                setpoints.write(bad, wait=True, timeout=1.0)
            except Exception:
                refused += 1
        after = list(setpoints.read().data)
        context.disconnect()
        print(json.dumps([len(got), [len(one) for one in got], back, refused, after]))
        """,
    )
    assert count >= 4 and set(sizes) == {180}
    np.testing.assert_allclose(back, 0.01 * np.arange(180), atol=1e-9)
    assert refused == 3
    assert after == back


def test_a_put_beyond_the_drive_limit_of_one_changes_none(port: int):
    with EpicsMachine(as_sim(), EpicsSettings(server_port=port)) as machine:
        before = machine.setpoints()
        machine.read(2.0)
        machine.write(np.where(np.arange(180) == 7, 19.0, before + 0.01))
        refused = [machine.read(2.0).refused for _ in range(3)]
        np.testing.assert_array_equal(machine.setpoints(), before)
        assert any(len(told) == 180 and "refuses puts" in told[7] for told in refused)


def as_sim():
    ring = small_ring(180)
    return replace(
        ring,
        orbit_pvs=tuple(f"SR:Orbit{{X}}-I.[{index}]" for index in range(180)),
        setpoint_pvs=tuple(f"SR:Currents{{X}}-SP.[{index}]" for index in range(180)),
        readback_pvs=tuple(f"SR:Currents{{X}}-I.[{index}]" for index in range(180)),
    )


@pytest.fixture(scope="module")
def ioc():
    with BaseIoc(as_arrays(small_ring(12)), 20.0) as ioc:
        yield ioc


def test_an_array_that_is_too_short_is_told_before_anything_moves(ioc: BaseIoc):
    with pytest.raises(MachineError, match="SR:Orbit-I holds 12 values, and element 12 is named"):
        EpicsMachine(as_arrays(small_ring(13)), EpicsSettings(server_port=ioc.port))


def test_setpoints_without_a_name_are_told_as_they_would_be_overwritten(ioc: BaseIoc):
    ring = as_arrays(small_ring(12))
    some = replace(
        ring,
        correctors=ring.correctors[:10],
        setpoint_pvs=ring.setpoint_pvs[:10],
        readback_pvs=ring.readback_pvs[:10],
    )
    with pytest.raises(MachineError, match="SR:Currents-SP holds 12 values, of which 10 are named"):
        EpicsMachine(some, EpicsSettings(server_port=ioc.port))


def test_what_somebody_else_puts_to_an_array_is_seen_and_stays():
    ring = as_arrays(small_ring(12))
    with BaseIoc(ring, 20.0) as ioc:
        settings = EpicsSettings(server_port=ioc.port)
        with EpicsMachine(ring, settings) as ours, EpicsMachine(ring, settings) as other:
            first = np.arange(12) == 0
            ours.write(np.full(12, 0.1))
            for _ in range(3):
                ours.read(2.0)
            other.setpoints()
            other.write(np.full(12, 0.7), np.arange(12) == 5)
            told = [ours.read(2.0).by_others for _ in range(4)]
            assert any(mask is not None and mask[5] for mask in told)
            ours.write(np.full(12, 0.2), first)
            ours.read(2.0)
            expected = np.where(first, 0.2, np.where(np.arange(12) == 5, 0.7, 0.1))
            np.testing.assert_allclose(ours.setpoints(), expected, atol=1e-9)
