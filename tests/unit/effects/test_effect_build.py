"""Effects in the plant."""

import numpy as np
import pytest

from orbitfb.effects.build import build, measured_response, plant_with
from orbitfb.effects.settings import EffectSettings, parse_effect
from orbitfb.physics.plant import Plant, PlantSettings

pytestmark = pytest.mark.usefixtures("examples")
QUIET = PlantSettings(bpm_noise_rms=0.0, ground_motion_rms=0.0, initial_orbit_rms=0.0)


def _plant(ring, *texts, seed=1):
    return plant_with(ring, "x", QUIET, seed, [parse_effect(text) for text in texts], 0.1)


def test_an_effect_begins_at_its_time_and_on_its_devices(ring):
    plant = _plant(ring, "example-gain:gain=10%,cells=3,from=200ms")
    setpoints = np.full(180, 0.01)
    before, also, then = (plant.step(setpoints).readback for _ in range(3))
    np.testing.assert_array_equal(before, setpoints)
    np.testing.assert_array_equal(also, setpoints)
    changed = np.flatnonzero(then != setpoints)
    assert len(changed) == 6
    np.testing.assert_allclose(then[changed], 0.011)


def test_a_device_is_known_by_its_pv_too(ring):
    pv = next(pv for pv, its in ring.devices_of_pvs("COR").items() if its == ("CL1A_C01", "x"))
    settings = EffectSettings(id="example-gain", values={"gain": 0.1}, names=(pv,))
    plant = plant_with(ring, "x", QUIET, 1, [settings], 0.1)
    moved = plant.step(np.full(180, 0.01)).readback
    assert [ring.names("COR")[i] for i in np.flatnonzero(moved != 0.01)] == ["CL1A_C01"]


def test_what_grows_grows_from_nothing_at_its_beginning(ring):
    plant = _plant(ring, "example-ramp:speed=1e-4,names=PL1A_C01,from=300ms")
    readings = [np.abs(plant.step(np.zeros(180)).reading).max() for _ in range(6)]
    assert readings[:3] == [0.0, 0.0, 0.0]
    assert readings[3] < 1e-8
    np.testing.assert_allclose(np.diff(readings[3:]), 1e-5, rtol=0.01)


def test_effects_add_up_and_each_has_its_own_random_numbers(ring):
    first, second = "example-ramp:names=PL1A_C01", "example-ramp:names=PL2A_C01"

    def readings(*texts):
        plant = _plant(ring, *texts)
        return np.array([plant.step(np.zeros(180)).reading for _ in range(4)])

    one, two = readings(first), readings(first, second)
    column = np.flatnonzero(one.any(axis=0))
    np.testing.assert_array_equal(two[:, column], one[:, column])
    other = [c for c in np.flatnonzero(two.any(axis=0)) if c not in column]
    assert len(other) == 1
    assert (two[:, other] != two[:, column]).all()
    np.testing.assert_array_equal(readings(first, second), two)
    np.testing.assert_array_equal(readings("example-gain:gain=0.2", first), one)


def test_without_effects_it_is_the_plant_as_it_was(ring):
    bare, with_none = Plant(ring, "x", None, 3), plant_with(ring, "x", PlantSettings(), 3, (), 0.1)
    for _ in range(3):
        np.testing.assert_array_equal(
            bare.step(np.zeros(180)).reading, with_none.step(np.zeros(180)).reading
        )


def test_a_slow_measurement_finds_gains_but_no_drift(layout):
    effects = [
        parse_effect("example-gain:gain=10%,names=CL1A_C01,from=30s"),
        parse_effect("example-ramp"),
    ]
    found = measured_response(layout, effects, seed=1, ticks=2)
    factor = np.ones(180)
    factor[layout.correctors.names.index("CL1A_C01")] = 1.1
    np.testing.assert_allclose(found, layout.response * factor, atol=1e-12)


def test_the_order_of_building_is_the_order_of_the_settings(layout):
    made = build([parse_effect("example-ring"), parse_effect("example-gain:from=1s")], layout, 1)
    assert [type(effect).__name__ for effect in made] == ["Effect", "Since"]
