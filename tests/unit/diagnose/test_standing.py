"""Errors of magnets that begin in the middle of a record, with the beam anywhere in the magnet."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.explain import Cause, actuated
from orbitfb.diagnose.fading import Steps
from orbitfb.diagnose.fit import fit
from orbitfb.diagnose.free import beyond
from orbitfb.diagnose.noise_walk import walking_candidates
from orbitfb.diagnose.proposals import _chosen
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.diagnose.standing import FreeSteps
from orbitfb.diagnose.tournament import tournament
from orbitfb.effects.build import build, layout_of
from orbitfb.effects.registry import all_effects
from orbitfb.effects.settings import parse_effect
from orbitfb.physics.places import Ring

RING = Ring.load()
LAYOUT = layout_of(RING, "x", 0.1)
KINDS = all_effects()
GRADIENT = KINDS["quadrupole-gradient"]
QUADRUPOLE = 40
NAME = GRADIENT.places_of(LAYOUT)[QUADRUPOLE]
ONSET = 200
"""The record begins after 20 s, so that 40 s is row 200."""


@pytest.fixture(scope="module")
def record():
    effects = build(
        [parse_effect(f"quadrupole-gradient:gradient=0.004,names={NAME},from=40s")], LAYOUT, 1
    )
    return simulate_record(RING, "x", 450, 5, effects, dither=3e-3, period=LAYOUT.period)


def stepped(record, kick):
    """The record of a beam that stood elsewhere in the quadrupole when the error began."""
    readings = record.readings.copy()
    readings[ONSET:] += kick * GRADIENT.patterns(LAYOUT)[:, QUADRUPOLE]
    return replace(record, readings=readings)


@pytest.mark.parametrize("kick", [0.3e-6, -1e-6])
def test_the_first_kick_of_a_gradient_says_nothing_of_its_size(record, kick):
    kinds = [GRADIENT, KINDS["sextupole"], KINDS["local-kick"], KINDS["bpm-offset"]]
    best = tournament(Bench(stepped(record, kick)), kinds)[0]
    assert (best.kind.id, best.cause.onset) == ("quadrupole-gradient", ONSET)
    assert best.fit is not None and best.fit.inflation < 1.2
    low, high = best.fit.interval(0)
    assert low < 0.004 < high
    assert best.cause.places == (QUADRUPOLE,)


@pytest.mark.parametrize("kick", [1e-6, -3e-6])
def test_nothing_walks_where_a_first_kick_stayed(record, kick):
    cause = Cause(GRADIENT, (QUADRUPOLE,), {"gradient": 0.004}, ONSET)
    bench = Bench(stepped(record, kick), (cause,))
    for name in ("energy-drift", "bpm-walk"):
        assert all(one.gain < 9.0 for one in walking_candidates(bench, KINDS[name]))


def test_what_a_first_kick_may_have_made_is_left_out_and_nothing_else(record):
    bench = Bench(record)
    steps = FreeSteps(record, bench.floor)
    cause = Cause(GRADIENT, (QUADRUPOLE,), {"gradient": 0.004}, ONSET)
    white = np.random.default_rng(2).standard_normal(bench.white.shape)
    moved = bench.floor.whiten(stepped(record, 5e-6).readings - record.readings, record.starts)
    without = beyond(steps.basis((cause,)))
    left = without(white)
    np.testing.assert_allclose(without(white + moved), left, atol=1e-9)
    assert np.sum(white**2) - np.sum(left**2) < 20.0  # χ² of one amplitude
    assert steps.price((cause,)) > 1.0
    for other in (replace(cause, onset=0), Cause(KINDS["local-kick"], (3,), {}, ONSET)):
        assert not len(steps.basis((other,))) and steps.price((other,)) == 0.0


def test_steps_of_many_places_and_onsets_are_those_of_dense_linear_algebra(record):
    """The projection on every whitened step, one by one, by least squares."""
    floor, starts = Bench(record).floor, record.starts.copy()
    starts[330] = True  # a new stretch ends what fades
    onsets = np.array([200, 200, 203, 340])
    orbits = np.random.default_rng(4).standard_normal((4, record.readings.shape[1])) * 1e-6
    rows = np.arange(len(record))[:, None]
    dense = np.array(
        [
            floor.whiten((rows >= onset) * orbit, starts).ravel()
            for onset, orbit in zip(onsets, orbits, strict=True)
        ]
    )
    steps = Steps(floor, starts, onsets, orbits)
    white = np.random.default_rng(2).standard_normal(record.readings.shape)
    left = white.ravel() - dense.T @ np.linalg.lstsq(dense.T, white.ravel(), rcond=None)[0]
    np.testing.assert_allclose(beyond(steps)(white).ravel(), left, atol=1e-9)
    np.testing.assert_allclose(steps.information, np.sum(dense**2, axis=1))
    twice = Steps(floor, starts, onsets[[0, 0]], orbits[[0, 0]])
    assert len(steps) == 4 and len(twice) == 1


def test_what_a_first_kick_is_free_to_do_tells_nothing(record):
    kicked = stepped(record, 5e-6)
    bench = Bench(kicked, (Cause(GRADIENT, (QUADRUPOLE,), {"gradient": 0.004}, ONSET),))
    step = kicked.readings - record.readings
    assert bench.information(step) < 1e-6 * bench.energy(step)


def test_the_twin_that_was_always_there_is_fitted_beside_one_that_begins_late():
    def proposal(kind, gain, onset, place=0):
        return Candidate(Cause(KINDS[kind], (place,), {}, onset), gain, 1.0)

    late, always = proposal("loop-delay", 100.0, 20), proposal("loop-delay", 30.0, 0)
    crowd = [proposal("corrector-lag", 99.0, 0, place) for place in range(20)]
    weak = [proposal("bpm-gain", 98.0, 20), proposal("bpm-gain", 10.0, 0)]
    found = sorted((late, always, *crowd, *weak), key=lambda one: one.gain, reverse=True)
    chosen = _chosen(found)
    assert late in chosen and always in chosen
    assert weak[0] in chosen and weak[1] not in chosen


@pytest.mark.parametrize("increments", [True, False])
def test_a_calibration_may_change_with_a_step_or_without(increments):
    """By what the corrector holds, or of its changes alone: the record says which."""
    column, onset = 50, 200
    record = simulate_record(RING, "x", 450, 5, dither=3e-3, period=LAYOUT.period)
    held = 0.02 * np.random.default_rng(3).standard_normal(len(LAYOUT.correctors))
    record = replace(record, setpoints=record.setpoints + held)
    own = record.setpoints[onset:, column]
    acting = own - own[0] if increments else own
    readings = record.readings.copy()
    readings[onset:] += 0.3 * np.outer(acting, LAYOUT.response[:, column])
    kinds = [KINDS["corrector-gain"], KINDS["local-kick"], KINDS["telegraph"]]
    best = tournament(Bench(replace(record, readings=readings)), kinds)[0]
    assert (best.kind.id, best.cause.places) == ("corrector-gain", (column,))
    assert abs(best.cause.onset - onset) < 4
    assert best.fit is not None
    low, high = best.fit.interval(0)
    assert low < 0.3 < high


@pytest.mark.parametrize("held", [True, False])
@pytest.mark.parametrize(
    ("kind", "columns", "change"),
    [
        ("corrector-polarity", (50,), [[-2.0]]),
        ("corrector-swap", (50, 57), [[-1.0, 1.0], [1.0, -1.0]]),
        ("corrector-crosstalk", (50, 51), [[0.0, 0.0], [0.3, 0.0]]),
    ],
)
def test_what_goes_wrong_with_currents_does_so_with_what_they_hold_or_with_changes(
    kind, columns, change, held
):
    """Operators had made up for what the correctors held, or had not."""
    record = simulate_record(RING, "x", 450, 5, dither=3e-3, period=LAYOUT.period)
    rest = 0.02 * np.random.default_rng(3).standard_normal(len(LAYOUT.correctors))
    moved = record.setpoints[ONSET:, columns] + (rest[list(columns)] if held else 0.0)
    readings = record.readings.copy()
    readings[ONSET:] += moved @ np.array(change).T @ LAYOUT.response[:, columns].T
    record = replace(record, setpoints=record.setpoints + rest, readings=readings)
    kinds = [KINDS[name] for name in (kind, "corrector-stuck", "local-kick", "telegraph")]
    best = tournament(Bench(record), kinds)[0]
    places = best.cause.places
    if best.kind.id != "corrector-polarity":
        places = tuple(best.kind.pairs(LAYOUT)[places[0]].tolist())
    assert (best.kind.id, places) == (kind, columns)
    assert best.cause.free is not held
    assert abs(best.cause.onset - ONSET) < 4


def test_a_crate_that_freezes_is_frozen_whatever_its_currents_held():
    """What a law of changes does to a held current is no current of the ring."""
    frozen = tuple(range(48, 54))
    names = "+".join(LAYOUT.correctors.names[place] for place in frozen)
    effects = build([parse_effect(f"corrector-stuck:names={names},from=40s")], LAYOUT, 1)
    record = simulate_record(RING, "x", 450, 5, effects, dither=1e-4, steering=0, period=0.1)
    rest = 0.02 * np.random.default_rng(3).standard_normal(len(LAYOUT.correctors))
    record = replace(record, setpoints=record.setpoints + rest)
    free = Cause(KINDS["corrector-gain"], frozen, {"gain": -0.9}, ONSET, free=True)
    acting, bench = actuated(record, (free,)), Bench(record)
    np.testing.assert_allclose(acting[ONSET], record.setpoints[ONSET])
    steps = np.diff(record.setpoints[ONSET:, frozen], axis=0)
    np.testing.assert_allclose(np.diff(acting[ONSET:, frozen], axis=0), 0.1 * steps)
    # nor is it a healthy error of one: the record is no likelier for it without the law
    other = bench.cleared_of((free,))
    assert other.full_log_likelihood < bench.full_log_likelihood + 5.0
    kinds = [KINDS[name] for name in ("corrector-stuck", "corrector-gain", "corrector-polarity")]
    best = tournament(bench, kinds)[0]
    assert (best.kind.id, best.cause.places) == ("corrector-stuck", frozen)


@pytest.mark.parametrize(("gain", "seen"), [(0.0, False), (0.3, True)])
def test_a_step_of_the_orbit_speaks_for_no_law_that_shows_in_nothing_else(gain, seen):
    places = tuple(range(8, 14))
    names = "+".join(LAYOUT.correctors.names[place] for place in places)
    told = f"corrector-gain:gain={gain},names={names},from=40s"
    quiet = simulate_record(
        RING, "x", 450, 5, build([parse_effect(told)], LAYOUT, 1), dither=2e-4, period=0.1
    )
    readings = quiet.readings.copy()
    readings[ONSET:] += 2e-3 * LAYOUT.response[:, list(places)] @ np.array([1, -2, 3, 1, -2, 2])
    bench = Bench(replace(quiet, readings=readings))
    cause = Cause(KINDS["corrector-gain"], places, {"gain": 0.1}, ONSET, free=True)
    found = fit(bench, (cause,))
    assert found.gain > 100.0
    assert (found.evidence > 20.0) is seen
