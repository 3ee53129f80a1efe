"""What every `Machine` promises: checks that take a machine, whatever is behind it.

A `Bench` says how to get one and how fast its orbits come; nothing else about it is known here.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from orbitfb.core.errors import MachineError, WriteError
from orbitfb.core.ports import Machine


@dataclass(frozen=True)
class Bench:
    """A machine under test.

    Args:
        machine: The machine, open.
        period: Between two orbits [s].
        wait: Lets so many seconds pass for this machine.
    """

    machine: Machine
    period: float
    wait: Callable[[float], None]

    @property
    def timeout(self) -> float:
        """Time in which an orbit must come on a loaded computer [s]."""
        return 20 * self.period + 1.0


def vectors_have_the_shapes_of_the_channels(bench: Bench) -> None:
    channels = bench.machine.channels
    n, m = len(channels.orbit_pvs), len(channels.setpoint_pvs)
    assert n == len(channels.bpms) > 0
    assert m == len(channels.correctors) == len(channels.readback_pvs) > 0
    reading = bench.machine.read(bench.timeout)
    assert reading.orbit.position.shape == reading.orbit.valid.shape == (n,)
    assert reading.readback.shape == (m,)
    assert bench.machine.setpoints().shape == (m,)


def readings_are_finite_where_valid_and_nan_elsewhere(bench: Bench) -> None:
    orbit = bench.machine.read(bench.timeout).orbit
    np.testing.assert_array_equal(np.isfinite(orbit.position), orbit.valid)


def readings_are_metres(bench: Bench) -> None:
    assert np.nanmax(np.abs(bench.machine.read(bench.timeout).orbit.position)) < 0.02


def slow_channels_are_known_in_si(bench: Bench) -> None:
    auxiliary = bench.machine.read(bench.timeout).auxiliary
    assert 0.01 < auxiliary["current"] < 1.0
    assert 4.9e8 < auxiliary["rf_frequency"] < 5.1e8


def an_orbit_is_never_returned_twice(bench: Bench) -> None:
    times = [bench.machine.read(bench.timeout).orbit.time for _ in range(10)]
    assert np.all(np.diff(times) > 0.0)  # after a standstill two may come in quick succession


def values_returned_are_not_changed_later(bench: Bench) -> None:
    first = bench.machine.read(bench.timeout)
    position, readback = first.orbit.position.copy(), first.readback.copy()
    bench.machine.read(bench.timeout)
    np.testing.assert_array_equal(first.orbit.position, position)
    np.testing.assert_array_equal(first.readback, readback)


def what_is_written_is_in_force_and_read_back(bench: Bench) -> None:
    machine = bench.machine
    before = machine.setpoints()
    wanted = np.linspace(-0.02, 0.02, before.size)
    applied = machine.write(wanted)
    np.testing.assert_array_equal(applied.setpoints, wanted)
    for _ in range(5):  # an IOC may take them at the next tick
        reading = machine.read(bench.timeout)
    np.testing.assert_allclose(machine.setpoints(), wanted, atol=1e-9)
    np.testing.assert_allclose(reading.readback, wanted, atol=1e-3)
    machine.write(before)


def only_those_that_are_asked_for_are_put(bench: Bench) -> None:
    """What somebody else sets on the others stays, and nothing is said of them, be it finite."""
    machine = bench.machine
    before = machine.setpoints()
    which = np.arange(before.size) % 3 != 0
    by_hand = np.where(which, before, before + 0.03)
    machine.write(by_hand, ~which)
    for others in (before, np.full_like(before, np.nan)):
        machine.write(np.where(which, before + 0.01, others), which)
        for _ in range(3):
            machine.read(bench.timeout)
        expected = np.where(which, before + 0.01, by_hand)
        np.testing.assert_allclose(machine.setpoints(), expected, atol=1e-9)
    machine.write(before, np.zeros_like(which))
    np.testing.assert_allclose(machine.setpoints(), expected, atol=1e-9)
    machine.write(before)
    for _ in range(3):
        machine.read(bench.timeout)
    np.testing.assert_allclose(machine.setpoints(), before, atol=1e-9)


def the_applied_setpoints_are_a_copy(bench: Bench) -> None:
    wanted = bench.machine.setpoints()
    expected = wanted.copy()
    applied = bench.machine.write(wanted)
    wanted[:] = 99.0
    np.testing.assert_array_equal(applied.setpoints, expected)


def setpoints_that_are_not_finite_are_refused_whole(bench: Bench) -> None:
    machine = bench.machine
    before = machine.setpoints()
    for wrong in (np.nan, np.inf, -np.inf):
        wanted = before + 0.01
        wanted[-1] = wrong
        with pytest.raises(WriteError, match=re.escape(machine.channels.setpoint_pvs[-1])):
            machine.write(wanted)
        which = np.zeros(before.size, dtype=np.bool_)
        which[[0, -1]] = True
        with pytest.raises(WriteError):
            machine.write(wanted, which)
    machine.read(bench.timeout)
    np.testing.assert_array_equal(machine.setpoints(), before)


def setpoints_of_the_wrong_shape_are_refused(bench: Bench) -> None:
    with pytest.raises(WriteError):
        bench.machine.write(bench.machine.setpoints()[:-1])


def a_closed_machine_refuses_everything(bench: Bench) -> None:
    """Last: the machine cannot be used afterwards."""
    machine = bench.machine
    setpoints = machine.setpoints()
    machine.close()
    machine.close()
    with pytest.raises(MachineError):
        machine.read(bench.period)
    with pytest.raises(MachineError):
        machine.setpoints()
    with pytest.raises(MachineError):
        machine.write(setpoints)


CHECKS: tuple[Callable[[Bench], None], ...] = (
    vectors_have_the_shapes_of_the_channels,
    readings_are_finite_where_valid_and_nan_elsewhere,
    readings_are_metres,
    slow_channels_are_known_in_si,
    an_orbit_is_never_returned_twice,
    values_returned_are_not_changed_later,
    what_is_written_is_in_force_and_read_back,
    only_those_that_are_asked_for_are_put,
    the_applied_setpoints_are_a_copy,
    setpoints_that_are_not_finite_are_refused_whole,
    setpoints_of_the_wrong_shape_are_refused,
    a_closed_machine_refuses_everything,
)
