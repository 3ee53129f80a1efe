"""What strikes by a clock is not what strikes at random times."""

from dataclasses import replace

import numpy as np
import pytest
from test_scans import LAYOUT, RING, record_with

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.departure import departure
from orbitfb.diagnose.rhythm import regular, rhythm
from orbitfb.diagnose.search import search
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.registry import all_effects

ROWS = 1000


def test_random_times_have_no_rhythm():
    gains = [
        regular(np.random.default_rng(seed).geometric(chance, 12), ROWS)
        for seed in range(200)
        for chance in (0.01, 0.05, 0.3)
    ]
    assert np.mean(np.array(gains) > 0.0) < 0.01


def test_a_clock_may_jitter_and_an_event_may_be_missed():
    even = np.full(8, 100)
    one = np.log(100.0) - 99.0 * np.log1p(-0.01)  # of a length of 100, at random
    price = np.log(3.0 * ROWS)
    assert regular(even, ROWS) == pytest.approx(8 * (one + np.log(0.9)) - price, abs=0.1)
    assert 0.0 < regular(even + np.array([1, -1, 0, 1, 0, -1, 1, 0]), ROWS) < regular(even, ROWS)
    assert regular(np.where(np.arange(8) == 3, 200, even), ROWS) > 5.0
    assert regular(even[:3], ROWS) == 0.0
    assert regular(np.ones(50, dtype=int), ROWS) == 0.0  # always on


@pytest.mark.parametrize("by_clock", [False, True])
def test_pulses_by_a_clock_are_told_from_a_source_that_switches(by_clock):
    telegraph = all_effects()["telegraph"]
    place = telegraph.places_of(LAYOUT).index("QL2A_C17 (x)")
    if by_clock:
        quiet = simulate_record(RING, "x", ROWS, 5, period=LAYOUT.period)
        pulses = 8e-8 * (np.arange(len(quiet)) % 110 == 60)
        orbit = pulses[:, None] * telegraph.patterns(LAYOUT)[:, place]
        record = replace(quiet, readings=quiet.readings + orbit)
    else:
        switching = "telegraph:kick=4e-8rad,probability=0.02,names=QL2A_C17"
        record = record_with(switching, dither=0.0, ticks=ROWS)
    found = search(record, [telegraph])
    one = found.winners[0]
    course = departure(found.bench, one.accepted.cause, one.accepted.gain, before=one.bench)
    assert (course.course == "by a clock, always after as many ticks") == by_clock
    assert (course.chance < 0.01) == by_clock


@pytest.mark.parametrize("by_clock", [False, True])
def test_writes_that_are_missed_by_a_clock_are_told_from_those_that_are_lost(by_clock):
    kind = all_effects()["missed-write"]
    if by_clock:
        quiet = simulate_record(RING, "x", ROWS, 5, dither=1e-3, period=LAYOUT.period)
        missed = np.flatnonzero(np.arange(ROWS) % 40 == 30)
        lost = quiet.setpoints[missed] - quiet.setpoints[missed - 1]
        readings = quiet.readings.copy()
        readings[missed] -= lost @ LAYOUT.response.T
        record = replace(quiet, readings=readings)
    else:
        record = record_with("missed-write:probability=0.025", dither=1e-3, ticks=ROWS)
    bench = Bench(record)
    found = search(record, [kind])
    assert (rhythm(bench, found.winners[0].accepted.cause) > 20.0) == by_clock
