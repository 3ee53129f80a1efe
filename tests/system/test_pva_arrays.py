"""Orbit, setpoints and readbacks over pvAccess: the loop, bad arrays, servers that go."""

import time
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from base_ioc_process import BaseIoc, as_arrays, small_ring
from service_process import Service

from benchmarks.array_places import array_places
from orbitfb.core.errors import ConnectError, MachineError, WriteError
from orbitfb.core.names import PVA
from orbitfb.epics.machine import EpicsMachine
from orbitfb.epics.settings import EpicsSettings

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(find_spec("p4p") is None, reason="the extra `pva` is not installed"),
]

RING, RATE_HZ = as_arrays(small_ring(12), PVA), 20.0


@pytest.fixture(scope="module")
def ioc():
    with BaseIoc(RING, RATE_HZ) as ioc:
        yield ioc


def test_a_loop_closes_on_arrays_over_pvaccess(tmp_path):
    places = array_places(tmp_path / "places.csv", PVA)
    file = tmp_path / "c.toml"
    file.write_text(f'[ring]\nplaces = "{places}"\n[sim]\npva_port = 0\n')
    with Service(tmp_path / "data", "sim", "--config", file) as service:
        service.wait_state("CLOSED")
        service.wait_below(1.0)


def test_arrays_that_do_not_hold_what_is_named_are_told(ioc: BaseIoc):
    with pytest.raises(MachineError, match="SR:Orbit-I holds 12 values, and element 12 is named"):
        EpicsMachine(as_arrays(small_ring(13), PVA), ioc.settings)
    some = replace(
        RING,
        correctors=RING.correctors[:10],
        setpoint_pvs=RING.setpoint_pvs[:10],
        readback_pvs=RING.readback_pvs[:10],
    )
    with pytest.raises(MachineError, match="SR:Currents-SP holds 12 values, of which 10 are named"):
        EpicsMachine(some, ioc.settings)
    scalar = replace(RING, orbit_pvs=tuple(f"{PVA}TEST:STAMP.[{i}]" for i in range(12)))
    with pytest.raises(MachineError, match="TEST:STAMP holds 1 values, and element 11 is named"):
        EpicsMachine(scalar, ioc.settings)


def test_pvs_that_no_server_has_are_listed(ioc: BaseIoc):
    settings = ioc.settings.model_copy(update={"connect_timeout": 0.5})
    unknown = replace(RING, readback_pvs=tuple(f"{PVA}SR:None.[{i}]" for i in range(12)))
    with pytest.raises(ConnectError, match="pva://SR:None"):
        EpicsMachine(unknown, settings)


def test_a_server_that_goes_and_comes_back_is_asked_before_it_is_written_to():
    with BaseIoc(RING, RATE_HZ) as ioc:
        settings = ioc.settings.model_copy(update={"reconnect_period": 0.2, "answer_timeout": 0.5})
        with EpicsMachine(RING, settings) as machine:
            machine.write(np.full(12, 0.1))
            machine.read(2.0)
            ioc.kill()
            with pytest.raises(WriteError):
                _until_away(machine)
            ioc.start()
            deadline = time.monotonic() + 20.0
            while machine.disconnected and time.monotonic() < deadline:
                time.sleep(0.05)
            machine.read(10.0)
            with pytest.raises(WriteError, match="have not been read since"):
                machine.write(np.full(12, 0.2))
            np.testing.assert_array_equal(machine.setpoints(), np.zeros(12))
            machine.write(np.full(12, 0.2))
            machine.read(2.0)
            np.testing.assert_allclose(machine.setpoints(), np.full(12, 0.2))


def _until_away(machine: EpicsMachine) -> None:
    for _ in range(200):
        machine.write(np.full(12, 0.3))
        time.sleep(0.02)


def test_puts_that_are_refused_are_told_with_the_next_orbit():
    with BaseIoc(RING, RATE_HZ, read_only=True) as ioc, EpicsMachine(RING, ioc.settings) as machine:
        machine.setpoints()
        machine.read(2.0)
        machine.write(np.full(12, 0.1))
        refused = [machine.read(2.0).refused for _ in range(4)]
        assert any(len(told) == 12 and "refuses puts" in told[7] for told in refused), refused
        np.testing.assert_array_equal(machine.setpoints(), np.zeros(12))


def test_without_the_extra_the_error_names_it(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(__import__("sys").modules, "p4p.client.raw", None)
    with pytest.raises(MachineError, match=r"pip install 'orbitfb\[pva\]'"):
        EpicsMachine(RING, EpicsSettings())
