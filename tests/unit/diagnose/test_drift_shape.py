"""Where no table tells how magnets move the orbit, the drift's own shape is no gap."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.ceiling import ceiling
from orbitfb.diagnose.drift_shape import with_own_shape
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.physics.places import Ring

RING = Ring.load()
ROWS, STEP = 800, 1e-6


@pytest.fixture(scope="module")
def readings():
    """Of a beam that a few groups of magnets move, far more than the readings scatter."""
    rng = np.random.default_rng(2)
    nothing = simulate_record(RING, "x", ROWS, 5, [])
    patterns = rng.standard_normal((nothing.readings.shape[1], 12))
    walk = np.cumsum(STEP * rng.standard_normal((len(nothing), 12)), axis=0)
    return nothing, nothing.readings + walk @ patterns.T


def correlated(bench):
    """Mean square of the correlations of the modes that drift, over that of chance."""
    white = bench.white[~bench.record.starts]
    strong = np.argsort(bench.floor.gains)[::-1][:12]
    together = np.corrcoef(white[:, strong].T)
    return len(white) * np.mean(together[np.triu_indices(12, 1)] ** 2)


def test_an_unknown_ring_drifts_in_its_own_modes(readings):
    nothing, read = readings
    strange = replace(nothing.layout, ring=None)
    its = Bench(replace(nothing, layout=strange, readings=read))
    own = with_own_shape(its)
    assert correlated(its) > 3.0
    assert correlated(own) < 1.5
    assert own.full_log_likelihood > its.full_log_likelihood
    assert not ceiling(own).resolved


def test_where_the_magnets_are_known_the_modes_are_theirs(readings):
    nothing, _ = readings
    its = Bench(nothing)
    assert with_own_shape(its) is its


def test_a_floor_that_was_told_keeps_its_modes(readings):
    nothing, _ = readings
    its = Bench(replace(nothing, layout=replace(nothing.layout, ring=None)))
    told = Bench(its.record, (), its.floor)
    assert with_own_shape(told) is told
