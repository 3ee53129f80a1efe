"""How loud a BPM is tells nothing of its gain: healthy ones differ."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from test_scans import BPMS, LAYOUT, RING

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fit import fit
from orbitfb.diagnose.healthy_levels import BETWEEN, HealthyLevels
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.build import build
from orbitfb.effects.registry import all_effects
from orbitfb.effects.settings import parse_effect

GAIN = all_effects()["bpm-gain"]
ROWS, MODES = 300, 7
NOISE, USUAL = 2e-7, -0.03


def levels(scatter):
    rng = np.random.default_rng(2)
    axes = np.linalg.qr(rng.standard_normal((MODES, MODES)))[0][[1, 4]]
    rows = np.ones(ROWS, dtype=bool)
    rows[:40] = False
    return HealthyLevels(rows, axes, USUAL, scatter), rng.standard_normal((ROWS, MODES))


def as_likely(noise, scatter):
    """Log-likelihood of the noise of one BPM, its level at the best one, by a search of its own."""

    def cost(level):
        return (
            0.5 * np.sum(noise**2) * np.exp(-2.0 * level)
            + len(noise) * level
            + 0.5 * ((level - USUAL) / scatter) ** 2
        )

    return -float(minimize_scalar(cost, bounds=(-3.0, 3.0), method="bounded").fun)


@pytest.mark.parametrize("scatter", [0.02, 0.1, 1.0])
def test_levels_are_the_most_likely_ones(scatter):
    its, before = levels(scatter)
    louder = before.copy()
    louder[its.rows] += 0.7 * (before[its.rows] @ its.axes[0])[:, None] * its.axes[0]
    left, owed = its.likeliest(before, louder)
    got = np.sum(owed) - 0.5 * np.sum(left**2)
    rest = np.sum(louder**2) - np.sum((louder[its.rows] @ its.axes.T) ** 2)
    expected = -0.5 * rest
    for axis in its.axes:
        usual = before[its.rows] @ axis
        expected += as_likely(louder[its.rows] @ axis, scatter)
        expected -= as_likely(usual, scatter) + 0.5 * np.sum(usual**2)
    assert got == pytest.approx(expected, abs=0.01)
    np.testing.assert_array_equal(left[:40], louder[:40])
    assert not np.any(owed[:40])


@pytest.mark.parametrize("scatter", [0.05, 1.0])
def test_levels_go_along_with_a_small_change(scatter):
    its, before = levels(scatter)
    change = 1e-5 * np.random.default_rng(4).standard_normal(before.shape)
    change[its.rows] += 1e-5 * (before[its.rows] @ its.axes[1])[:, None] * its.axes[1]
    usual = 1.1 * before
    start, owed_before = its.likeliest(usual, before)
    end, owed_after = its.likeliest(usual, before + change)
    moved, owed = its.following(before, change)
    steady = ~its.rows
    np.testing.assert_allclose(moved[steady], change[steady])
    assert np.sum(owed) == pytest.approx(np.sum(owed_after - owed_before), rel=1e-3, abs=1e-8)
    assert np.sum((moved - (end - start)) ** 2) < 0.02 * np.sum(change**2)


def loud(factor, gain):
    """A record of a loop that stands still, or is steered; one BPM is louder, or its gain wrong."""
    texts = [f"bpm-gain:gain={gain},names={BPMS[20]}"] if gain else []
    effects = build([parse_effect(text) for text in texts], LAYOUT, 1)
    steering = 4 if gain else 0
    record = simulate_record(RING, "x", 600, 5, effects, steering=steering, period=LAYOUT.period)
    readings = record.readings.copy()
    noise = np.random.default_rng(3).standard_normal(len(record))
    readings[:, 20] += np.sqrt(factor**2 - 1.0) * NOISE * noise
    return Bench(replace(record, readings=readings))


def gained(bench):
    cause = Cause(GAIN, (20,), {"gain": 0.05})
    return fit(bench, (cause,))


def test_a_louder_bpm_of_an_orbit_that_stands_still_is_no_gain():
    found = gained(loud(1.15, 0.0))
    unlikely = 0.5 * (np.log(1.15) / (0.5 * BETWEEN)) ** 2  # so loud a healthy BPM
    assert found.gain < unlikely + 3.0  # 21 where its noise is evidence


def test_a_gain_is_seen_where_the_orbit_moves_however_loud_the_bpm():
    found = gained(loud(1.15, 0.2))
    assert found.gain > 30.0
    low, high = found.interval(0)
    assert low - 0.01 < 0.2 < high + 0.01
