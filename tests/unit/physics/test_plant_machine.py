"""The in-process machine: virtual time, the one-tick delay, the faults on request."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from orbitfb.core.clock import ManualClock
from orbitfb.core.errors import MachineError, NoOrbitError, WriteError
from orbitfb.physics.plant import Plant, PlantSettings
from orbitfb.physics.plant_machine import PlantMachine

QUIET = PlantSettings(bpm_noise_rms=0, ground_motion_rms=0, initial_orbit_rms=0)


@pytest.fixture
def clock():
    return ManualClock(start=1000.0)


@pytest.fixture
def machine(ring, clock):
    return PlantMachine(Plant(ring, "x", QUIET), clock, period=0.1)


def test_reads_are_a_period_apart_and_move_the_clock(machine, clock):
    readings = [machine.read(1.0) for _ in range(4)]
    assert_allclose([r.orbit.time for r in readings], [1000.1, 1000.2, 1000.3, 1000.4])
    assert_allclose(clock.wall(), 1000.4)
    assert readings[-1].received == clock.monotonic()


def test_what_is_written_after_an_orbit_shows_in_the_next(machine):
    machine.read(1.0)
    setpoints = np.linspace(-1, 1, 180)
    applied = machine.write(setpoints)
    assert_array_equal(applied.setpoints, setpoints)
    assert_array_equal(machine.setpoints(), setpoints)
    reading = machine.read(1.0)
    assert_allclose(reading.orbit.position, machine.plant.response @ setpoints)
    assert_array_equal(reading.readback, setpoints)


def test_the_callers_array_is_not_kept(machine):
    setpoints = np.ones(180)
    machine.write(setpoints)
    setpoints[:] = 5
    machine.setpoints()[:] = 7
    assert_array_equal(machine.setpoints(), 1.0)


def test_the_auxiliary_channels(ring, clock):
    machine = PlantMachine(Plant(ring, "x"), clock)
    auxiliary = machine.read(1.0).auxiliary
    assert auxiliary["current"] == 0.4
    assert auxiliary["rf_frequency"] == pytest.approx(1320 * 299_792_458.0 / 791.958)
    assert auxiliary["true_orbit_rms"] == pytest.approx(250e-6)
    machine.current = 0.0
    assert machine.read(1.0).auxiliary["current"] == 0.0


@pytest.mark.parametrize("value", [18.01, -19.0, np.nan, np.inf])
def test_a_setpoint_out_of_range_is_named_and_nothing_is_written(machine, value):
    setpoints = np.ones(180)
    setpoints[3] = value
    with pytest.raises(WriteError, match="nothing was written") as caught:
        machine.write(setpoints)
    assert machine.channels.setpoint_pvs[3] in str(caught.value)
    assert_array_equal(machine.setpoints(), 0.0)


def test_setpoints_of_a_wrong_shape_are_refused(machine):
    with pytest.raises(WriteError, match="180 correctors"):
        machine.write(np.zeros(360))


def test_reads_made_to_fail_take_their_time_and_lose_orbits(machine, clock):
    machine.fail_next_reads(2)
    for _ in range(2):
        with pytest.raises(NoOrbitError):
            machine.read(0.35)
    assert machine.plant.tick == 6
    assert_allclose(clock.wall(), 1000.6)
    assert_allclose(machine.read(1.0).orbit.time, 1000.7)


def test_writes_made_to_fail_change_nothing(machine):
    machine.fail_next_writes(1)
    with pytest.raises(WriteError):
        machine.write(np.ones(180))
    assert_array_equal(machine.setpoints(), 0.0)
    machine.write(np.ones(180))
    assert_array_equal(machine.setpoints(), 1.0)


def test_masked_bpms_are_nan_and_invalid(machine):
    machine.mask(2, 5)
    orbit = machine.read(1.0).orbit
    assert_array_equal(np.flatnonzero(~orbit.valid), [2, 5])
    assert_array_equal(np.flatnonzero(np.isnan(orbit.position)), [2, 5])
    machine.unmask()
    assert machine.read(1.0).orbit.valid.all()


def test_a_frozen_machine_repeats_its_orbit_while_the_ring_goes_on(ring, clock):
    machine = PlantMachine(Plant(ring, "x"), clock)
    first = machine.read(1.0).orbit
    machine.freeze()
    repeated = machine.read(1.0).orbit
    assert repeated.time == first.time
    assert_array_equal(repeated.position, first.position)
    machine.thaw()
    assert_allclose(machine.read(1.0).orbit.time, 1000.3)


def test_a_closed_machine_says_so(machine):
    machine.write(np.ones(180))
    machine.close()
    with pytest.raises(MachineError, match="closed"):
        machine.read(1.0)
