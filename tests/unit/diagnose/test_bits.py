"""Bits of a converter that never change."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.bits import silent_bit
from orbitfb.diagnose.departure import departure
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.registry import all_effects
from orbitfb.physics.places import Ring


def moved(rows=1500, seed=1):
    rng = np.random.default_rng(seed)
    steered = 40e-6 + 4e-6 * np.sin(np.arange(rows) / 50)
    return steered + 1e-6 * rng.standard_normal(rows)


def without_bit(readings, bit, stuck=0):
    return readings - bit * ((np.floor(readings / bit) % 2) - stuck)


@pytest.mark.parametrize("stuck", [0, 1])
@pytest.mark.parametrize("bit", [0.1e-6, 0.33e-6])
def test_a_bit_that_never_changes_is_found_with_its_size(bit, stuck):
    found, nats = silent_bit(without_bit(moved(), bit, stuck))
    assert found == pytest.approx(bit, rel=0.01)
    assert nats > 500.0


@pytest.mark.parametrize(
    "readings",
    [
        moved(),
        np.round(moved() / 0.1e-6) * 0.1e-6,
        np.where(np.arange(1500) % 300 < 150, 1.0, 9.0) * 1e-6 + 0.1 * moved(),  # two levels
        np.zeros(1500),
        np.full(1500, np.nan),
        moved(40),
    ],
)
def test_other_readings_have_none(readings):
    assert silent_bit(readings) == (0.0, 0.0)


def test_more_noise_of_a_bpm_is_held_to_its_converter():
    record = simulate_record(Ring.load(), "x", 700, 5, dither=2e-3)
    readings = record.readings.copy()
    readings[:, 20] = without_bit(readings[:, 20], 0.33e-6)
    bench = Bench(replace(record, readings=readings))
    cause = Cause(all_effects()["noise-level"], (20,), {"factor": 1.3})
    its = departure(bench, cause, 30.0)
    assert its.course.startswith("as a converter whose bit of 0.33")
    assert its.stand_in and its.chance < 0.01
    other = departure(bench, replace(cause, places=(21,)), 30.0)
    assert other.course == "" and other.chance > 0.8
