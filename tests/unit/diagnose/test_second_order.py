"""Healthy errors do not add up: closed bumps show it, and it is no gap."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.diagnose.background import GAIN_RMS, _gradient_scatters
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.bent import Bent
from orbitfb.diagnose.second_order import second_order
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.build import layout_of
from orbitfb.effects.optics.gradients import SIGN, response_with
from orbitfb.physics.places import Ring
from orbitfb.records.layout import HealthyErrors

RING = Ring.load()
LAYOUT = layout_of(RING, "x", 0.1)
SCATTERS = _gradient_scatters(LAYOUT)
RNG = np.random.default_rng(8)
GRADIENTS = SCATTERS * RNG.normal(size=len(SCATTERS))
GAINS = GAIN_RMS * RNG.normal(size=LAYOUT.response.shape[1])
ERRORS = HealthyErrors(GAINS, {"x": SIGN["x"] * GRADIENTS})
BUMPS = tuple(range(100, 700, 60))


def record_of(large: float, gains=GAINS):
    """A ring with healthy errors and one bump after the other, of so large orbits [m]."""
    quiet = simulate_record(RING, "x", 700, 1, steering=0)
    tunes = RING.table.beta[:, RING.places("QUAD")].T
    kept = GRADIENTS - tunes @ np.linalg.lstsq(tunes, GRADIENTS, rcond=None)[0]
    wrong = response_with(LAYOUT, kept) * (1.0 + gains)
    steps = np.zeros_like(quiet.setpoints)
    for place, row in enumerate(BUMPS):
        columns = np.arange(4) + 5 * place  # neighbours, some of them in two bumps
        closed = np.linalg.svd(LAYOUT.response[:, columns])[2][-1]
        each = np.sqrt(np.mean((LAYOUT.response[:, columns] * closed) ** 2, axis=0).sum())
        steps[row, columns] = closed * (large / each)
    setpoints = quiet.setpoints + np.cumsum(steps, axis=0)
    readings = quiet.readings - quiet.setpoints @ LAYOUT.response.T + setpoints @ wrong.T
    return replace(quiet, setpoints=setpoints, readings=readings)


def excess(bench: Bench) -> float:
    """Sum of squares at the bumps over what noise makes it, in its standard deviations."""
    squares = bench.white[list(BUMPS)] ** 2
    return float((squares - 1.0).sum() / np.sqrt(2.0 * squares.size))


def test_healthy_errors_leave_nothing_of_bumps_once_they_are_added_up_around_themselves() -> None:
    bench = Bench(record_of(3e-3))
    assert excess(bench) > 8.0
    around = second_order(bench)
    assert around.record.layout.healthy is not None
    assert excess(around) < 4.0
    assert around.full_log_likelihood > bench.full_log_likelihood + 30.0
    assert second_order(around) is around


def test_where_nothing_is_seen_of_it_the_record_stays_as_it_is() -> None:
    bench = Bench(record_of(1e-4))
    assert second_order(bench) is bench


def test_errors_that_have_swallowed_a_cause_are_nothing_to_go_by() -> None:
    bench = Bench(record_of(3e-3, 20.0 * GAINS))
    assert second_order(bench) is bench


def test_further_errors_change_the_response_of_the_ring_that_has_the_first_ones() -> None:
    bent = Bent(replace(LAYOUT, healthy=ERRORS))
    np.testing.assert_allclose(bent.response, response_with(LAYOUT, GRADIENTS), rtol=1e-8)
    more = 1e-4 * SCATTERS * np.random.default_rng(1).normal(size=len(SCATTERS))
    changed = (response_with(LAYOUT, GRADIENTS + more) - bent.response) * (1.0 + GAINS)
    found = bent.orbit_per_kick("x") * (SIGN["x"] * more) @ bent.orbit_at("x")
    np.testing.assert_allclose(found, changed, rtol=1e-2, atol=1e-4 * np.abs(changed).max())


def test_the_bend_is_all_that_the_sum_of_the_errors_leaves() -> None:
    layout = replace(LAYOUT, healthy=ERRORS)
    bent, whole = Bent(layout), response_with(LAYOUT, GRADIENTS) * (1.0 + GAINS)
    kicks = bent.orbit_per_kick("x") * ERRORS.kicks["x"] @ bent.orbit_at("x")
    linear = LAYOUT.response + bent.response * GAINS + kicks
    np.testing.assert_allclose(linear + bent.bend(), whole, atol=1e-9 * np.abs(whole).max())
    assert np.abs(Bent(LAYOUT).bend()).max() == pytest.approx(0.0)
