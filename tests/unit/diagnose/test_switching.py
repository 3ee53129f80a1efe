"""Sources that switch to and fro are told by the course of their states."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.random_values import state
from orbitfb.diagnose.search import search
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.diagnose.switching import Course, follow, switching_candidates
from orbitfb.effects.build import build, layout_of
from orbitfb.effects.registry import all_effects
from orbitfb.effects.settings import parse_effect
from orbitfb.physics.places import Ring

RING = Ring.load()
LAYOUT = layout_of(RING, "x", 0.1)
KINDS = all_effects()
TELEGRAPH = KINDS["telegraph"]
PLACES = TELEGRAPH.places_of(LAYOUT)
PLACE = 100


def pulses(states: np.ndarray, strength: float, kept: float, seed: int) -> np.ndarray:
    """What a filter with memory makes of a source, in unit noise: the model, written plainly."""
    summed = np.random.default_rng(seed).standard_normal(len(states))
    echo = 0.0
    for row in range(1, len(states)):
        echo = kept * echo + states[row] - states[row - 1]
        summed[row] += strength * echo
    return summed


def followed(summed: np.ndarray) -> Course:
    """Follow one chain beside another one, which must not disturb it."""
    return follow(summed, np.array([2.5, 1.0]), 0.4, np.array([0.03, 0.1]))[0]


def test_the_states_of_a_chain_are_found_from_its_pulses():
    rng = np.random.default_rng(1)
    states = np.where(np.cumsum(rng.random(600) < 0.03) % 2, 1.0, -1.0)
    course = followed(pulses(states, 2.5, 0.4, 2))
    found, true = course.switches, np.flatnonzero(np.diff(states)) + 1
    assert len(true) > 10 and np.array_equal(found, true)
    assert course.evidence < -3.0 * len(true)  # each switch has its price
    assert course.likelihood + course.evidence > 50.0


def test_noise_alone_has_no_course():
    course = followed(np.random.default_rng(3).standard_normal(600))
    assert course.likelihood + course.evidence < 0.0


@pytest.fixture(scope="module")
def record():
    effect = f"telegraph:kick=0.03urad,probability=0.02,names={PLACES[PLACE].split()[0]}"
    return simulate_record(
        RING, "x", 800, 5, build([parse_effect(effect)], LAYOUT, 4), period=LAYOUT.period
    )


def test_a_source_that_switches_is_no_row_of_kicks(record):
    kinds = [TELEGRAPH, KINDS["local-kick"], KINDS["ground-motion-level"]]
    found = search(record, kinds)
    (cause,) = found.causes
    assert cause.kind is TELEGRAPH
    assert cause.places == (PLACE,)
    stated = state(Bench(record), cause)
    low, high = stated.intervals["kick"]
    assert low < 3e-8 < high < 1.3 * low
    low, high = stated.intervals["probability"]
    assert low < 0.02 < high < 4.0 * low
    # what it did is taken out of the record: nothing of it is left to be found
    assert found.rounds[-1].accepted is None and len(found.rounds) == 2


def test_steps_of_all_sizes_are_no_switching():
    pattern = TELEGRAPH.patterns(LAYOUT)[:, PLACE]
    rng = np.random.default_rng(6)
    quiet = simulate_record(RING, "x", 800, 5, period=LAYOUT.period)
    rows = len(quiet)
    steps = np.where(rng.random(rows) < 0.02, rng.exponential(6e-8, rows), 0.0)
    signs = np.where(np.cumsum(steps > 0) % 2, 1.0, -1.0)
    walked = replace(quiet, readings=quiet.readings + np.outer(np.cumsum(signs * steps), pattern))
    assert not switching_candidates(Bench(walked), TELEGRAPH)
    even = replace(quiet, readings=quiet.readings + np.outer(3e-8 * signs, pattern))
    best = switching_candidates(Bench(even), TELEGRAPH)[0]
    assert best.cause.places == (PLACE,)
