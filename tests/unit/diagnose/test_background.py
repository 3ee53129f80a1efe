"""Healthy errors against dense linear algebra, and the ladder against the filters it stands for."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.diagnose.background import (
    BEAT_RMS,
    GAIN_RMS,
    OPTICS_RMS,
    TUNE_RMS,
    _gradient_scatters,
)
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.diagnose.ladder import Ladder, information
from orbitfb.diagnose.noise_modes import NoiseModes
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.build import layout_of
from orbitfb.effects.optics.gradients import response_with
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Ring

RING = Ring.load()
QUADS = RING.places("QUAD")
STRENGTH, BETA = np.abs(RING.strength("QUAD")), RING.table.beta[:, QUADS]


def healthy(bench: Bench) -> tuple[Matrix, Matrix, Matrix]:
    """Every healthy error as orbit = size · pattern · driver, and the precision of the sizes."""
    layout = bench.record.layout
    beats = [
        np.sqrt(np.sum((STRENGTH * BETA[row]) ** 2) / 8) / abs(np.sin(2 * np.pi * RING.tune(plane)))
        for row, plane in enumerate(("x", "y"))
    ]
    scatter = STRENGTH * BEAT_RMS / np.sqrt(np.mean(np.square(beats)))
    n, m = layout.response.shape
    patterns = np.hstack([layout.response, np.eye(n), layout.orbit_per_kick("QUAD", "x")])
    at_quads = bench.currents @ layout.orbit_at("QUAD", "x").T
    drivers = np.hstack([GAIN_RMS * bench.currents, GAIN_RMS * bench.orbit, scatter * at_quads])
    tune = np.concatenate([np.zeros(n + m), BETA[0] * scatter / (4 * np.pi)])
    precision = np.eye(len(tune)) + np.outer(tune, tune) / TUNE_RMS**2
    return patterns, drivers - drivers.mean(axis=0), precision


def test_what_healthy_errors_leave_of_a_change_is_that_of_the_dense_regression() -> None:
    """They leave the tune, so that they do not hide a shift of it."""
    bench = Bench(simulate_record(RING, ticks=120, seed=4))
    layout, starts = bench.record.layout, bench.record.starts
    patterns, drivers, precision = healthy(bench)
    seen = np.array(
        [
            bench.floor.whiten(np.outer(driver, pattern), starts).ravel()
            for pattern, driver in zip(patterns.T, drivers.T, strict=True)
        ]
    )
    shift = STRENGTH * BETA[0]  # all gradients together
    shift *= 0.02 * 4 * np.pi / float(shift @ BETA[0])
    at_quads = bench.currents @ layout.orbit_at("QUAD", "x").T
    change = (shift * at_quads) @ layout.orbit_per_kick("QUAD", "x").T
    white = bench.floor.whiten(change, starts).ravel()
    known, pull = seen @ seen.T, seen @ white

    def left(prior: Matrix) -> float:
        return float(white @ white - pull @ np.linalg.solve(known + prior, pull))

    assert bench.information(change) == pytest.approx(left(precision), rel=0.01)
    assert left(precision) > 1.2 * left(np.eye(len(pull)))


def test_what_a_record_leaves_open_of_healthy_errors_is_that_of_the_dense_regression() -> None:
    bench = Bench(simulate_record(RING, ticks=120, seed=4, dither=1e-3))
    patterns, drivers, precision = healthy(bench)
    starts = bench.record.starts
    seen = np.array(
        [
            bench.floor.whiten(np.outer(driver, pattern), starts).ravel()
            for pattern, driver in zip(patterns.T, drivers.T, strict=True)
        ]
    )
    prior, both = np.linalg.slogdet(precision)[1], np.linalg.slogdet(seen @ seen.T + precision)[1]
    assert both - prior > 20.0
    assert bench.background.log_volume == pytest.approx(0.5 * (prior - both), rel=0.01)


@pytest.mark.parametrize("drift", [0.0, 1e-6, 0.1, 1e30])
def test_a_ladder_sees_what_the_first_rows_show(drift: float) -> None:
    """Without drift the gain is never steady, and an orbit that is steered away shows at once."""
    rng = np.random.default_rng(3)
    floor = NoiseFloor(NoiseModes.even(np.eye(4)), 2.0, np.full(4, 2.0 * drift))
    starts = np.zeros(300, dtype=bool)
    starts[[0, 120]] = True
    patterns = rng.normal(size=(4, 3))
    drivers = rng.normal(size=(300, 3)) + 50.0 * np.exp(-np.arange(300) / 8.0)[:, None]
    whitened = [
        floor.whiten(np.outer(driver, pattern), starts).ravel()
        for pattern, driver in zip(patterns.T, drivers.T, strict=True)
    ]
    ladder = Ladder(floor)
    found = information(ladder.shapes(patterns), ladder.filtered(drivers, starts))
    np.testing.assert_allclose(found, np.array(whitened) @ np.array(whitened).T, rtol=1e-3)


def test_healthy_gradients_do_to_steered_orbits_what_an_unknown_ring_is_given() -> None:
    ring, rng = Ring.load(), np.random.default_rng(0)
    layout = layout_of(ring, "x", 0.1)
    scatter = _gradient_scatters(layout)
    nominal = response_with(layout, np.zeros(len(scatter)))
    modes, values, directions = np.linalg.svd(layout.response)
    inverse = directions.T * (values / (values**2 + (0.02 * values[0]) ** 2))
    shares = []
    for _ in range(20):
        change = response_with(layout, scatter * rng.normal(size=len(scatter))) - nominal
        smooth = modes[:, :20] @ rng.normal(size=20)
        currents = inverse @ (modes.T @ np.column_stack([smooth, np.eye(180)[:, [0, 50, 100]]]))
        shares.append(np.sum((change @ currents) ** 2) / np.sum((layout.response @ currents) ** 2))
    assert np.sqrt(np.mean(shares)) == pytest.approx(OPTICS_RMS, rel=0.25)


def test_every_orbit_that_a_dither_steers_is_wrong_by_itself_in_an_unknown_ring() -> None:
    ring, rng = Ring.load(), np.random.default_rng(3)
    whole = layout_of(ring, "x", 0.1)
    scatter = _gradient_scatters(whole)
    wrong = response_with(whole, scatter * rng.normal(size=len(scatter)))
    quiet = simulate_record(RING, "x", 600, 3, steering=0)
    few = np.arange(0, len(wrong), 4)
    response = whole.response[np.ix_(few, few)]
    _, values, directions = np.linalg.svd(response)
    # A dither that moves the orbit by as much in 30 modes.
    shaped = directions[:30].T * (5e-6 / np.sqrt(30.0) * np.sqrt(len(few)) / values[:30])
    setpoints = rng.normal(size=(len(quiet), 30)) @ shaped.T
    layout = replace(
        whole,
        ring=None,
        response=response,
        bpms=whole.bpms.only(few),
        correctors=whole.correctors.only(few),
    )
    # Steps of the setpoints alone: what the loop did is in the readings, as drift.
    still = quiet.readings[:, few] - quiet.setpoints @ whole.response[few].T
    healthy_ring, exact = (
        replace(
            quiet,
            layout=layout,
            setpoints=setpoints,
            requested=np.zeros_like(setpoints),
            readings=still + setpoints @ its.T,
            readback=None,
            reference=None,
            filled=quiet.filled[:, few],
        )
        for its in (wrong[np.ix_(few, few)], response)
    )
    told = Bench(exact)
    left = Bench(healthy_ring, (), told.floor).white[1:]
    without = Bench(healthy_ring, (), told.floor, background=0.0).white[1:]
    excess, before = (np.mean(own**2) - np.mean(told.white[1:] ** 2) for own in (left, without))
    assert before > 0.3
    assert excess < 0.05 * before
