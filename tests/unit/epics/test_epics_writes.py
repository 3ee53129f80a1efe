"""What EpicsMachine refuses to write, and what it hears of puts: without sockets."""

import numpy as np
import pytest
from fake_libca import Bench

from orbitfb.core.errors import ConnectError, MachineError, WriteError
from orbitfb.epics.connecting import steps_of, wait_for_channels
from orbitfb.epics.settings import AuxiliarySettings, EpicsSettings


class Late:
    """A clock on which the time is always over."""

    def __init__(self):
        self.now = 0.0

    def monotonic(self):
        self.now += 1.0
        return self.now


@pytest.fixture
def bench(monkeypatch):
    return Bench(monkeypatch)


def test_a_setpoint_that_was_away_is_not_written_before_it_is_read(bench):
    bench.machine.write(np.array([0.1, 0.2, 0.3]))
    bench.library.puts.clear()
    bench.link(1, up=False)
    bench.link(1, up=True)
    with pytest.raises(WriteError, match="1 of 3 setpoints were away and have not been read since"):
        bench.machine.write(np.array([0.1, 0.2, 0.3]))
    assert not bench.library.puts
    others = np.array([True, False, True])
    bench.machine.write(np.array([0.1, 0.2, 0.3]), others)
    assert bench.library.puts == ["COR0", "COR2"]
    bench.machine.setpoints()
    bench.machine.write(np.array([0.1, 0.2, 0.3]))


def test_one_that_goes_while_it_is_read_is_not_known(bench):
    get = bench.library.ca_array_get

    def get_and_lose(kind, count, handle, address):
        bench.link(1, up=False)
        bench.link(1, up=True)
        return get(kind, count, handle, address)

    bench.library.ca_array_get = get_and_lose
    bench.machine.setpoints()
    with pytest.raises(WriteError, match="have not been read since: COR1"):
        bench.machine.write(np.zeros(3))


def test_a_put_that_the_server_refuses_is_heard_once(bench):
    bench.refuse(2)
    bench.machine.write(np.array([0.1, 0.2, 0.3]))
    heard = bench.machine._setpoints.errors.take
    assert heard() == {2: "refuses puts: Channel write request failed"}
    assert heard() == {}


def test_a_setpoint_without_write_access_is_told_with_every_orbit_and_not_put(bench):
    bench.rights(0, 1)
    for _ in range(2):
        assert bench.machine._setpoints.errors.take() == {0: "may not be written"}
    with pytest.raises(WriteError, match="1 of 3 setpoints are read-only: COR0"):
        bench.machine.write(np.zeros(3))
    bench.machine.write(np.zeros(3), np.array([False, True, True]))


def test_drive_limits_are_read_again_when_a_setpoint_is_not_what_was_sent(bench):
    assert np.isnan(bench.machine.drive_limits).all()
    bench.library.limits["COR1"] = (-0.05, 0.05)
    bench.machine.write(np.array([0.1, 0.04, 0.1]))
    bench.machine.setpoints()
    assert np.isnan(bench.machine.drive_limits).all()  # nothing was clipped: nobody asks
    bench.machine.write(np.array([0.1, 0.31, 0.1]))
    assert bench.machine.setpoints().tolist() == [0.1, 0.05, 0.1]
    np.testing.assert_array_equal(bench.machine.drive_limits[1], [-0.05, 0.05])


def test_records_of_whole_numbers_are_taken_with_their_step(bench):
    bench.library.types["COR1"] = 5
    machine = bench.machine
    wait_for_channels(machine._groups, machine._setpoints.group, EpicsSettings(), bench.clock)
    assert machine.steps.tolist() == [0.0, 1.0, 0.0]
    coarse = EpicsSettings(setpoint_step=0.25)
    assert steps_of(machine._setpoints.group, coarse).tolist() == [0.25, 1.0, 0.25]
    assert steps_of(machine._setpoints.group, EpicsSettings(setpoint_step=1.5)).tolist() == [
        1.5,
        2.0,
        1.5,
    ]


@pytest.mark.parametrize(("kind", "word"), [(4, "bytes"), (3, "an enumeration"), (0, "text")])
def test_setpoints_that_cannot_hold_a_current_are_refused_at_the_start(bench, kind, word):
    bench.library.types["COR1"] = kind
    machine = bench.machine
    with pytest.raises(
        MachineError, match=f"1 of 3 setpoints cannot hold a current:\n  COR1 is {word}\n"
    ):
        wait_for_channels(machine._groups, machine._setpoints.group, EpicsSettings(), bench.clock)


def test_masked_devices_are_not_waited_for_at_the_start(bench):
    machine, clock = bench.machine, bench.clock
    bench.rights(0, 1)
    settings = EpicsSettings()
    with pytest.raises(MachineError, match="1 of 3 setpoints may not be written"):
        wait_for_channels(machine._groups, machine._setpoints.group, settings, clock)
    machine._groups[0].connected[1] = False
    wait_for_channels(machine._groups, machine._setpoints.group, settings, clock, ("COR0", "BPM1"))
    machine._setpoints.group.connected[0] = False  # where it is must be known all the same
    brief = EpicsSettings(connect_timeout=1e-9)
    with pytest.raises(ConnectError, match=r"1 of 11 PVs(.|\n)*\(the places table\)"):
        wait_for_channels(
            machine._groups, machine._setpoints.group, brief, Late(), ("COR0", "BPM1")
        )


def test_the_start_says_where_the_names_are_from_that_do_not_answer(bench):
    machine = bench.machine
    machine._groups[0].connected[:] = False
    slow = {"current": AuxiliarySettings(pv=machine._groups[0].names[0])}
    brief = EpicsSettings(connect_timeout=1e-9, auxiliary=slow)
    with pytest.raises(ConnectError, match=r"\(the places table and epics.auxiliary\)"):
        wait_for_channels(machine._groups, machine._setpoints.group, brief, Late())
