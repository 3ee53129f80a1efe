"""A crate of BPMs with a trigger of its own."""

import dataclasses

import numpy as np
import pytest

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.departure import departure
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.random_values import state
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.diagnose.strike_scan import latent_candidates
from orbitfb.effects.sensors.clock_jitter import ClockJitter
from orbitfb.physics.places import Ring

RING = Ring.load()
KIND = ClockJitter()
RMS = 8e-3


def shaken(part: slice = slice(None), louder: int | None = None):
    """A record of which the BPMs of C14 are read a little early or late in some rows.

    Only early where the orbit stands still between its steps: late samples then see nothing.
    """
    record = simulate_record(RING, "x", 900, 11, dither=3e-3, steering=0)
    columns = record.layout.bpms.groups()["C14"]
    slope = KIND.shapes(record, record.setpoints, record.readings)[:, columns]
    rng = np.random.default_rng(3)
    shift = np.zeros(len(record))
    shift[part] = RMS * rng.standard_normal(len(record))[part]
    if part != slice(None):
        shift = np.minimum(shift, 0.0)
    readings = record.readings.copy()
    readings[:, columns] += shift[:, None] * slope
    if louder is not None:
        readings[:, louder] += 3e-7 * rng.standard_normal(len(record))
    return dataclasses.replace(record, readings=readings), tuple(columns.tolist())


@pytest.fixture(scope="module")
def crate():
    return shaken()


def test_a_crate_that_is_read_early_or_late_is_found(crate):
    record, columns = crate
    bench = Bench(record)
    found = max(latent_candidates(bench, KIND), key=lambda c: c.gain - np.log(c.choices))
    assert found.cause.places == columns
    assert found.gain > 20.0 + np.log(found.choices)
    stated = state(bench, found.cause)
    low, high = stated.intervals["rms"]
    assert 0.9 * low < RMS < 1.1 * high and high < 1.5 * low
    assert departure(bench, found.cause, found.gain).chance > 0.8


def test_a_bpm_that_is_noisy_by_itself_makes_no_crate():
    record, columns = shaken(slice(0, 0), louder=40)
    for its in latent_candidates(Bench(record), KIND):
        assert its.gain < np.log(its.choices), (its.cause.places, columns)


def test_samples_that_only_come_early_and_from_some_row_on_are_no_other_law():
    record, columns = shaken(slice(400, None))
    cause = Cause(KIND, columns, {"rms": 0.5 * RMS})
    assert departure(Bench(record), cause, 40.0).chance > 0.8
