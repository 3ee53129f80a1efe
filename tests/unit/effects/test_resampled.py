"""Readings that are late because two noisy samples are averaged: plant, inverse and Jacobian."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from test_sensor_effects import PLACES, ROWS, record_of, run, walk

from orbitfb.effects.registry import effect

KIND = effect("bpm-latency")
EDGE = 60
"""Rows after which nothing is left of what is taken for the sample that no reading tells."""


def resampled(ticks):
    return {"ticks": ticks, "resampled": 1.0}


def noisy(layout):
    """Orbits, and noise of their samples, shape (N, n) [m]."""
    noise = 0.2e-6 * np.random.default_rng(5).standard_normal((ROWS, len(layout.bpms)))
    return walk(layout), noise


@pytest.mark.parametrize("ticks", [0.3, 0.8, 1.0, 2.6])
def test_two_samples_are_averaged_with_their_noise(layout, ticks):
    orbit, noise = noisy(layout)
    read = run(KIND, layout, PLACES, resampled(ticks), orbit, noise)
    sample, whole = orbit + noise, int(ticks)
    at, part = np.arange(whole + 1, ROWS), ticks - whole
    expected = (1.0 - part) * sample[at - whole] + part * sample[at - whole - 1]
    assert_allclose(read[at][:, PLACES], expected[:, PLACES], rtol=0, atol=1e-15)
    assert_array_equal(np.delete(read, PLACES, axis=1), np.delete(sample, PLACES, axis=1))


@pytest.mark.parametrize("ticks", [0.02, 0.3, 0.5, 0.7, 0.98, 1.3, 2.7])
def test_the_samples_are_found_again(layout, ticks):
    orbit, noise = noisy(layout)
    read = run(KIND, layout, PLACES, resampled(ticks), orbit, noise)
    record, sample = record_of(layout, read), (orbit + noise)[:, PLACES]
    found, _ = KIND.restore(read[:, PLACES], resampled(ticks), record)
    assert_allclose(found[EDGE:-EDGE], sample[EDGE:-EDGE], rtol=0, atol=1e-13)
    # At neither end is anything far from a sample, where the walk makes steps of 30 µm.
    assert np.abs(found - sample).max() < 1e-3
    assert not KIND.heard(orbit[:, PLACES], resampled(ticks), record).any()
    assert KIND.heard(orbit[:, PLACES], {"ticks": ticks}, record).any()


@pytest.mark.parametrize("ticks", [0.3, 0.7, 2.4, 2.6])
def test_every_stretch_is_undone_for_itself(layout, ticks):
    readings = walk(layout)[:, PLACES]
    record = record_of(layout, walk(layout), (0, 60, 61, 63, 130))
    found, jacobian = KIND.restore(readings, resampled(ticks), record)
    for piece in record.stretches:
        alone = record.rows(piece.start, piece.stop)
        apart, own = KIND.restore(readings[piece], resampled(ticks), alone)
        assert_array_equal(found[piece], apart)
        assert_array_equal(jacobian[piece], own)


@pytest.mark.parametrize("ticks", [0.3, 0.5, 0.7, 1.2, 1.9])
def test_the_jacobian_is_the_determinant_of_samples_by_readings(layout, ticks):
    record, values = record_of(layout, walk(layout, 15), (0, 7)), resampled(ticks)
    readings, unread = record.readings[:, :1], KIND.unread(values)
    base, told = KIND.restore(readings, values, record)
    dense = np.empty((len(record), len(record)))
    for row in range(len(record)):
        moved = readings.copy()
        moved[row] += 1e-6
        dense[:, row] = (KIND.restore(moved, values, record)[0] - base)[:, 0] / 1e-6
    for piece in record.stretches:
        # The last samples of a stretch are not read, nor are its first readings of any use.
        block = dense[piece.start : piece.stop - unread, piece.start + unread : piece.stop]
        assert_allclose(np.linalg.slogdet(block)[1], told[piece].sum(), atol=1e-9)
        assert told[piece.start] == 0.0
        assert not told[piece.stop - unread : piece.stop].any() or unread == 0
    _, three = KIND.restore(record.readings[:, :3], values, record)
    assert_allclose(three, 3.0 * told)


def test_a_fuller_law_is_that_of_a_part_of_a_tick(layout):
    record = record_of(layout, walk(layout))
    assert KIND.fuller({"ticks": 1.25, "resampled": 0.0}, record) == resampled(1.25)
    assert KIND.fuller({"ticks": 2.0, "resampled": 0.0}, record) is None
    assert KIND.fuller(resampled(1.25), record) is None
    assert [p.name for p in KIND.fitted(record)] == ["ticks"]
