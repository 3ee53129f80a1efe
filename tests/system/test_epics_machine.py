"""EpicsMachine against an EPICS-base IOC in a process of its own."""

import math
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from base_ioc_process import CURRENT, RF_FREQUENCY, BaseIoc, is_coherent, small_ring
from free_ports import free_port
from service_process import wait_for

from orbitfb.core.errors import ConnectError, MachineError
from orbitfb.epics.machine import EpicsMachine
from orbitfb.epics.settings import AuxiliarySettings, EpicsSettings

pytestmark = pytest.mark.system

SIZE, RATE_HZ = 12, 20.0
RING = small_ring(SIZE)


@pytest.fixture(scope="module")
def ioc() -> Iterator[BaseIoc]:
    with BaseIoc(RING, RATE_HZ) as process:
        yield process


@pytest.fixture
def machine(ioc: BaseIoc) -> Iterator[EpicsMachine]:
    with EpicsMachine(RING, EpicsSettings(server_port=ioc.port)) as machine:
        yield machine


@pytest.mark.timing
def test_orbits_are_coherent_and_none_is_left_out(machine: EpicsMachine):
    readings = [machine.read(1.0) for _ in range(20)]
    assert all(is_coherent(reading.orbit.position) for reading in readings)
    assert all(reading.orbit.valid.all() for reading in readings)
    ticks = [round(reading.orbit.position[0] * 1e6) for reading in readings]
    assert np.all(np.diff(ticks) % 1000 == 1)
    assert all(abs(time.time() - reading.orbit.time) < 5.0 for reading in readings)


def test_slow_channels_are_si(machine: EpicsMachine):
    auxiliary = machine.read(1.0).auxiliary
    assert auxiliary == {"current": CURRENT * 1e-3, "rf_frequency": RF_FREQUENCY}
    assert all(0.0 < age < 60.0 for age in machine.auxiliary_ages().values())


@pytest.mark.timing
def test_readback_is_of_the_tick_of_the_orbit(ioc: BaseIoc):
    """What was written between orbits n − 1 and n is in readback n, whole and never later.

    On a loaded computer a write may miss its tick; then it is in the next one.
    """
    settings = EpicsSettings(server_port=ioc.port, readback_wait=0.8 / RATE_HZ)
    late = 0
    with EpicsMachine(RING, settings) as machine:
        for value in range(1, 11):
            machine.read(1.0)
            machine.write(np.full(SIZE, float(value)))
            readback = machine.read(1.0).readback
            assert np.ptp(readback) == 0.0
            if readback[0] != value:
                late += 1
                readback = machine.read(1.0).readback
            np.testing.assert_array_equal(readback, np.full(SIZE, float(value)))
    assert late <= 4


@pytest.mark.parametrize("without", [range(0, SIZE, 2), range(SIZE)])
def test_a_corrector_without_a_readback_shows_the_setpoint_in_force(
    ioc: BaseIoc, without: range
) -> None:
    """Also one that somebody else has put; it never says that the supply has acted."""
    none = np.isin(np.arange(SIZE), [*without])
    names = tuple("" if no else pv for no, pv in zip(none, RING.readback_pvs, strict=True))
    ring = replace(RING, readback_pvs=names)
    settings = EpicsSettings(server_port=ioc.port)
    with EpicsMachine(ring, settings) as machine, EpicsMachine(RING, settings) as other:
        assert machine.channel_counts()[2].channels == SIZE - none.sum()
        other.read(1.0)
        for writer, value in ((machine, 1.5), (other, -2.5)):
            machine.read(1.0)
            writer.write(np.full(SIZE, value))

            def arrived(value: float = value) -> bool:
                return bool((machine.read(1.0).readback == value).all())

            wait_for("readbacks", arrived, 5.0)
        reading = machine.read(1.0)
        assert reading.behind is not None and reading.behind[none].all()
        if not none.all():
            late = [machine.read(1.0).behind for _ in range(5)]
            assert any(not behind[~none].any() for behind in late if behind is not None)


def test_every_write_arrives(machine: EpicsMachine):
    wanted = np.random.default_rng(1).uniform(-10, 10, SIZE)
    applied = machine.write(wanted)
    np.testing.assert_array_equal(applied.setpoints, wanted)
    assert applied.time == pytest.approx(time.time(), abs=5.0)
    np.testing.assert_array_equal(machine.setpoints(), wanted)


def test_each_bpm_has_the_unit_of_the_table(ioc: BaseIoc):
    """The records of this IOC state none."""
    units = ("mm", "um") * (SIZE // 2)
    settings = EpicsSettings(server_port=ioc.port)
    with EpicsMachine(replace(RING, bpm_units=units), settings) as machine:
        position = machine.read(1.0).orbit.position
    assert is_coherent(position * np.tile([1.0, 1e3], SIZE // 2))
    asked = EpicsSettings(server_port=ioc.port, bpm_unit="egu")
    with pytest.raises(MachineError, match=f"{SIZE} of {SIZE} BPM PVs state no unit of length"):
        EpicsMachine(RING, asked)


def test_drive_limits_come_from_the_server(machine: EpicsMachine):
    np.testing.assert_array_equal(machine.drive_limits, np.tile([-18.0, 18.0], (SIZE, 1)))


def test_drive_limits_are_nan_where_the_server_states_none(ioc: BaseIoc):
    switches = replace(RING, setpoint_pvs=("TEST:SKIP",), correctors=("S",), readback_pvs=())
    with EpicsMachine(switches, EpicsSettings(server_port=ioc.port)) as machine:
        assert np.isnan(machine.drive_limits).all()


@pytest.mark.timing
def test_a_slow_reader_gets_the_newest_orbit(machine: EpicsMachine):
    machine.read(1.0)
    time.sleep(6 / RATE_HZ)
    reading = machine.read(1.0)
    assert time.time() - reading.orbit.time < 1.5 / RATE_HZ + 0.05


def test_all_missing_pvs_are_listed_at_once(ioc: BaseIoc):
    wrong = replace(
        RING,
        orbit_pvs=(*RING.orbit_pvs[:-1], "SR:C99-BI{BPM:1}Pos:X-I"),
        setpoint_pvs=(*RING.setpoint_pvs[:-1], "SR:C99-MG{PS:CH1A}I:Sp1-SP"),
    )
    auxiliary = {"current": AuxiliarySettings(pv="SR:C99-BI{DCCT:1}I:Real-I")}
    settings = EpicsSettings(server_port=ioc.port, connect_timeout=0.5, auxiliary=auxiliary)
    with pytest.raises(ConnectError) as caught:
        EpicsMachine(wrong, settings)
    assert set(caught.value.missing) == {
        "SR:C99-BI{BPM:1}Pos:X-I",
        "SR:C99-MG{PS:CH1A}I:Sp1-SP",
        "SR:C99-BI{DCCT:1}I:Real-I",
    }
    assert str(caught.value).startswith("3 of 37 PVs did not connect within 0.5 s:")
    assert f"port {ioc.port}" in str(caught.value)


@pytest.mark.timing
def test_no_machine_at_all_is_told_after_the_time_allowed():
    start = time.monotonic()
    with pytest.raises(ConnectError, match=r"38 of 38 PVs"):
        EpicsMachine(RING, EpicsSettings(server_port=free_port(), connect_timeout=0.5))
    assert time.monotonic() - start < 2.0


def test_read_only_setpoints_are_listed():
    with (
        BaseIoc(RING, RATE_HZ, read_only=True) as ioc,
        pytest.raises(MachineError, match=r"12 of 12 setpoints may not be written") as caught,
    ):
        EpicsMachine(RING, EpicsSettings(server_port=ioc.port))
    shown = [name in str(caught.value) for name in RING.setpoint_pvs]
    assert all(shown[:10])  # of many the first ones are named


def test_two_machines_in_one_process_keep_to_their_own_networks():
    with (
        BaseIoc(RING, RATE_HZ) as one,
        BaseIoc(RING, RATE_HZ) as two,
        EpicsMachine(RING, EpicsSettings(server_port=one.port)) as left,
        EpicsMachine(RING, EpicsSettings(server_port=two.port)) as right,
    ):
        left.write(np.full(SIZE, 1.0))
        right.write(np.full(SIZE, 2.0))
        np.testing.assert_array_equal(left.setpoints(), np.full(SIZE, 1.0))
        np.testing.assert_array_equal(right.setpoints(), np.full(SIZE, 2.0))
        two.kill()
        left.read(1.0)
        assert is_coherent(left.read(1.0).orbit.position)


def test_other_threads_may_write_and_ask(machine: EpicsMachine):
    answers = []

    def ask() -> None:
        machine.write(np.full(SIZE, 5.0))
        answers.append(machine.setpoints())

    thread = threading.Thread(target=ask)
    thread.start()
    thread.join(5.0)
    np.testing.assert_array_equal(answers[0], np.full(SIZE, 5.0))
    machine.read(1.0)


def test_close_leaves_no_thread_and_wakes_the_reader(ioc: BaseIoc):
    with EpicsMachine(RING, EpicsSettings(server_port=ioc.port)):
        pass  # pyepics' own context, which stays, has its threads from now on
    before, running = len(os.listdir("/proc/self/task")), threading.active_count()
    machine = EpicsMachine(RING, EpicsSettings(server_port=ioc.port))
    machine.read(1.0)
    machine.close()
    time.sleep(0.2)
    assert len(os.listdir("/proc/self/task")) == before
    assert threading.active_count() == running


@pytest.mark.parametrize("leave", ["machine.close()", "pass", "os._exit(0)"])
def test_nothing_is_printed_and_no_repeater_started(ioc: BaseIoc, leave: str):
    code = f"""
import os, sys
sys.path[:0] = {[os.path.dirname(__file__), os.path.dirname(os.path.dirname(__file__))]!r}
from base_ioc_process import small_ring
from orbitfb.epics.machine import EpicsMachine
from orbitfb.epics.settings import EpicsSettings
machine = EpicsMachine(small_ring({SIZE}), EpicsSettings(server_port={ioc.port}))
machine.read(1.0)
{leave}
"""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, timeout=30, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")


def test_ring_of_the_default_size():
    ring = small_ring(180)
    with (
        BaseIoc(ring, 10.0) as ioc,
        EpicsMachine(ring, EpicsSettings(server_port=ioc.port)) as machine,
    ):
        wanted = np.linspace(-17.0, 17.0, 180)
        machine.write(wanted)
        readings = [machine.read(1.0) for _ in range(10)]
        assert all(is_coherent(reading.orbit.position) for reading in readings)
        np.testing.assert_array_equal(readings[-1].readback, wanted)
        np.testing.assert_array_equal(machine.setpoints(), wanted)
        assert not math.isnan(readings[-1].auxiliary["current"])
