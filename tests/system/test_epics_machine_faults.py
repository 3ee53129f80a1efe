"""What EpicsMachine does when the IOC misbehaves, hangs, dies and comes back."""

import sys
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from base_ioc_process import BaseIoc, is_coherent, small_ring
from free_ports import free_port
from ioc_clients import run_client

from orbitfb.core.errors import MachineError, NoOrbitError, WriteError
from orbitfb.epics.machine import EpicsMachine
from orbitfb.epics.settings import EpicsSettings

pytestmark = pytest.mark.system

SIZE, RATE_HZ = 12, 20.0
RING = small_ring(SIZE)
PV_KEYS = ("bpms", "correctors", "orbit_pvs", "setpoint_pvs", "readback_pvs")


@pytest.fixture(scope="module")
def ioc() -> Iterator[BaseIoc]:
    with BaseIoc(RING, RATE_HZ) as process:
        yield process


@pytest.fixture
def machine(ioc: BaseIoc) -> Iterator[EpicsMachine]:
    with EpicsMachine(RING, EpicsSettings(server_port=ioc.port)) as machine:
        yield machine


class FaultSwitch:
    """Switches faults of the IOC on, through a machine whose correctors are the switches."""

    def __init__(self, ioc: BaseIoc) -> None:
        pvs = ("TEST:SKIP", "TEST:NAN", "TEST:INVALID")
        switches = replace(RING, correctors=pvs, setpoint_pvs=pvs, readback_pvs=pvs)
        self._machine = EpicsMachine(switches, EpicsSettings(server_port=ioc.port))

    def set(self, skip: int = -1, nan: int = -1, invalid: int = -1) -> None:
        self._machine.write(np.array([skip, nan, invalid], dtype=np.float64))
        time.sleep(2.5 / RATE_HZ)

    def close(self) -> None:
        time.sleep(0.1)
        self._machine.close()


@pytest.fixture
def faults(ioc: BaseIoc) -> Iterator[FaultSwitch]:
    switch = FaultSwitch(ioc)
    yield switch
    for _ in range(3):  # the skipped BPM holds up the switch's own orbit, so it may be silent
        switch.set()
    switch.close()


@pytest.mark.timing
def test_a_torn_orbit_is_refused_and_the_late_bpm_named(ioc: BaseIoc, faults: FaultSwitch):
    with EpicsMachine(RING, EpicsSettings(server_port=ioc.port, stuck_bpms=0)) as machine:
        faults.set(skip=7)
        with pytest.raises(NoOrbitError) as caught:
            for _ in range(3):
                machine.read(0.2)
        assert "11 of 12 BPMs carry stamp" in str(caught.value)
        assert f"{RING.orbit_pvs[7]} still at" in str(caught.value)
        faults.set(skip=-1)
        assert is_coherent(machine.read(1.0).orbit.position)


def test_a_bpm_that_keeps_its_stamp_is_masked_and_comes_back(
    machine: EpicsMachine, faults: FaultSwitch
):
    machine.read(1.0)
    faults.set(skip=7)
    for _ in range(3):
        orbit = machine.read(1.0).orbit
    np.testing.assert_array_equal(orbit.valid, np.arange(SIZE) != 7)
    assert is_coherent(orbit.position)
    faults.set(skip=-1)
    read_whole(machine)


@pytest.mark.parametrize("kind", ["nan", "invalid"])
def test_a_bpm_without_a_usable_value_is_masked(
    machine: EpicsMachine, faults: FaultSwitch, kind: str
):
    faults.set(**{kind: 3})
    machine.read(1.0)
    orbit = machine.read(1.0).orbit
    expected = np.arange(SIZE) != 3
    np.testing.assert_array_equal(orbit.valid, expected)
    np.testing.assert_array_equal(np.isfinite(orbit.position), expected)


@pytest.mark.timing
def test_killed_ioc_gives_no_orbit_and_takes_no_write_until_it_is_back():
    with (
        BaseIoc(RING, RATE_HZ) as ioc,
        EpicsMachine(RING, EpicsSettings(server_port=ioc.port, reconnect_period=0.5)) as machine,
    ):
        machine.read(1.0)
        machine.write(np.full(SIZE, 2.0))
        ioc.kill()
        time.sleep(0.05)
        start = time.monotonic()
        with pytest.raises(NoOrbitError, match="all 38 channels are disconnected"):
            for _ in range(2):
                machine.read(0.1)
        assert time.monotonic() - start < 0.5
        with pytest.raises(WriteError, match="12 of 12 setpoints are disconnected"):
            machine.write(np.full(SIZE, 3.0))
        with pytest.raises(MachineError, match=r"12 of 12 PVs did not answer"):
            machine.setpoints()
        time.sleep(1.0)
        ready = ioc.start()
        first = read_when_back(machine)
        assert first - ready < 3.0
        assert is_coherent(machine.read(1.0).orbit.position)
        # Nothing that was refused, nor anything older, has been sent to the new process.
        np.testing.assert_array_equal(machine.setpoints(), np.zeros(SIZE))
        assert not machine.disconnected
        machine.write(np.full(SIZE, 4.0))
        np.testing.assert_array_equal(machine.setpoints(), np.full(SIZE, 4.0))


def read_when_back(machine: EpicsMachine) -> float:
    """Read until an orbit comes; returns that moment, monotonic clock [s]."""
    deadline = time.monotonic() + 20.0
    while time.monotonic() < deadline:
        try:
            machine.read(0.05)
        except NoOrbitError:
            continue
        return time.monotonic()
    raise AssertionError("the machine did not come back")


@pytest.mark.timing
@pytest.mark.nightly
@pytest.mark.parametrize("away", [1.0, 30.0])
def test_back_soon_however_long_it_was_away(away: float, record_property):
    with (
        BaseIoc(RING, RATE_HZ) as ioc,
        EpicsMachine(RING, EpicsSettings(server_port=ioc.port)) as machine,
    ):
        machine.read(1.0)
        ioc.kill()
        time.sleep(away)
        ready = ioc.start()
        took = read_when_back(machine) - ready
        record_property("seconds_from_ready_to_orbit", took)
        sys.stdout.write(f"away {away} s: orbit {took:.2f} s after READY\n")
        assert took < 3.0


def read_again(machine: EpicsMachine, words: str) -> str:
    """Read until the message is there; empty words: until an orbit comes."""
    for _ in range(600):
        try:
            machine.read(0.2)
        except NoOrbitError as error:
            if words and words in str(error):
                return str(error)
        else:
            if not words:
                return ""
    raise AssertionError(words)


def wait_for_all(machine: EpicsMachine) -> None:
    """Wait until every channel is back: setpoints may come after the BPMs."""
    for _ in range(600):
        if not machine.disconnected:
            return
        time.sleep(0.02)
    raise AssertionError(machine.disconnected)


def put_field(ioc: BaseIoc, name: str, value: object) -> None:
    """Set a field of a record of the IOC, as an expert does."""
    run_client(
        ioc.port,
        f"""
        from caproto.threading.client import Context
        context = Context()
        [pv] = context.get_pvs({name!r})
        pv.write([{value!r}], wait=True)
        context.disconnect()
        print("true")
        """,
    )


def test_a_unit_that_is_edited_without_an_outage_holds_and_is_told():
    with (
        BaseIoc(RING, RATE_HZ, bpm_unit="mm") as ioc,
        EpicsMachine(RING, EpicsSettings(server_port=ioc.port)) as machine,
    ):
        machine.read(5.0)
        put_field(ioc, f"{RING.orbit_pvs[3]}.EGU", "um")
        assert f"{RING.orbit_pvs[3]}: um, before mm" in read_again(machine, "another unit")
        with pytest.raises(WriteError, match=r"another unit .* nothing was sent"):
            machine.write(np.zeros(SIZE))
        put_field(ioc, f"{RING.orbit_pvs[3]}.EGU", "mm")
        read_again(machine, "")
        machine.write(np.zeros(SIZE))
        assert not machine.disconnected


def test_drive_limits_that_are_edited_without_an_outage_are_known():
    with (
        BaseIoc(RING, RATE_HZ) as ioc,
        EpicsMachine(RING, EpicsSettings(server_port=ioc.port)) as machine,
    ):
        assert machine.drive_limits[2].tolist() == [-18.0, 18.0]
        put_field(ioc, f"{RING.setpoint_pvs[2]}.DRVH", 5.0)
        for _ in range(200):
            machine.read(1.0)
            if machine.drive_limits[2].tolist() == [-18.0, 5.0]:
                return
        raise AssertionError(machine.drive_limits)


def test_bpms_that_come_back_with_another_unit_hold_and_are_told():
    port = free_port()

    def served(unit: str) -> BaseIoc:
        return BaseIoc(RING, RATE_HZ, port=port, bpm_unit=unit)

    with served("mm") as ioc, EpicsMachine(RING, EpicsSettings(server_port=port)) as machine:
        machine.read(5.0)
        ioc.kill()
        read_again(machine, "disconnected")
        with served("um"):
            told = read_again(machine, "another unit")
            assert f"{RING.orbit_pvs[0]}: um, before mm" in told
            wait_for_all(machine)
            machine.setpoints()
            with pytest.raises(WriteError, match=r"another unit .* nothing was sent"):
                machine.write(np.zeros(SIZE))
        read_again(machine, "disconnected")
        with served("mm"):
            read_again(machine, "")
            wait_for_all(machine)
            machine.setpoints()
            machine.write(np.zeros(SIZE))


def test_half_of_the_machine_away_is_masked_and_comes_back():
    first = replace(RING, **{k: getattr(RING, k)[:6] for k in PV_KEYS})
    second = replace(RING, **{k: getattr(RING, k)[6:] for k in PV_KEYS})
    with BaseIoc(first, RATE_HZ) as one, BaseIoc(second, RATE_HZ, auxiliary={}) as two:
        settings = EpicsSettings(
            address_list=f"127.0.0.1:{one.port} 127.0.0.1:{two.port}",
            stamp_window=2.0 / RATE_HZ,  # the two do not tick together
            reconnect_period=0.5,
        )
        with EpicsMachine(RING, settings) as machine:
            read_whole(machine)
            two.kill()
            time.sleep(0.2)
            for _ in range(3):
                reading = machine.read(1.0)
            np.testing.assert_array_equal(reading.orbit.valid, np.arange(SIZE) < 6)
            assert np.isnan(reading.readback[6:]).all()
            assert np.isfinite(reading.readback[:6]).all()
            assert set(machine.disconnected) > set(RING.setpoint_pvs[6:])
            with pytest.raises(WriteError, match=r"6 of 12 setpoints are disconnected"):
                machine.write(np.ones(SIZE))
            time.sleep(2 / RATE_HZ)
            np.testing.assert_array_equal(machine.read(1.0).readback[:6], np.zeros(6))
            two.start()
            read_whole(machine)


def read_whole(machine: EpicsMachine) -> None:
    """Read until every BPM is valid."""
    deadline = time.monotonic() + 5.0
    while not machine.read(1.0).orbit.valid.all():
        assert time.monotonic() < deadline


@pytest.mark.timing
def test_hung_ioc_looks_connected_but_takes_no_write():
    settings = {"silent_after": 0.5, "stale_after": 0.5}
    with (
        BaseIoc(RING, RATE_HZ) as ioc,
        EpicsMachine(RING, EpicsSettings(server_port=ioc.port, **settings)) as machine,
    ):
        machine.read(1.0)
        ioc.freeze()
        try:
            with pytest.raises(NoOrbitError, match=r"12 of 12 BPMs still carry stamp"):
                for _ in range(8):
                    machine.read(0.1)
            time.sleep(0.6)
            assert not machine.disconnected
            with pytest.raises(WriteError, match="nothing was sent to a machine that may hang"):
                machine.write(np.ones(SIZE))
        finally:
            ioc.thaw()
        machine.read(2.0)
        time.sleep(2 / RATE_HZ)
        np.testing.assert_array_equal(machine.read(1.0).readback, np.zeros(SIZE))
