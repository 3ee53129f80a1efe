"""A cause acts as its law says, or something else at its devices shows through."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.courses import trials
from orbitfb.diagnose.departure import (
    AWRY,
    IDEAL,
    OUTSIDE,
    TOLD,
    UNTOLD,
    Departure,
    departure,
)
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fit import fit
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.actuating import ColumnsEffect
from orbitfb.effects.build import build, layout_of
from orbitfb.effects.registry import all_effects
from orbitfb.effects.settings import parse_effect
from orbitfb.physics.effect import Effect
from orbitfb.physics.places import Ring

RING = Ring.load()
LAYOUT = layout_of(RING, "x", 0.1)
COLUMN = LAYOUT.correctors.names.index("CL1A_C05")


class OvershootsUpwards(ColumnsEffect):
    """A law of no library: upward steps are too large, downward ones are right."""

    def __init__(self, places, size):
        super().__init__(places)
        self._size, self._last = size, None

    def follow(self, wanted):
        last = wanted if self._last is None else self._last
        self._last = wanted.copy()
        return wanted + self._size * np.maximum(wanted - last, 0.0)


def departs(*effects) -> tuple[Departure, float]:
    """Departure of the best gain of the corrector, and that gain."""
    record = simulate_record(RING, "x", 700, 5, effects, dither=2e-3, period=LAYOUT.period)
    kind = all_effects()["corrector-gain"]
    found = fit(Bench(record), (Cause(kind, (COLUMN,), {"gain": 0.1}),))
    bench = Bench(record, found.causes)
    return departure(bench, found.causes[0], found.gain), found.gain


def test_a_cause_of_the_library_does_not_depart_from_its_law():
    told = build([parse_effect("corrector-gain:gain=0.3,names=CL1A_C05")], LAYOUT, 1)
    its, gain = departs(*told)
    assert gain > 100.0
    assert its.nats < 0.05 * gain
    assert its.chance > 0.5 and not its.stand_in


@pytest.mark.parametrize(
    ("told", "dither", "steered"),
    [
        ("bpm-gain:gain=-0.15", 0.0, 3e-6),
        ("bpm-gain:gain=0.1", 2e-3, 10e-6),
        ("bpm-nonlinearity:quadratic=2000", 2e-3, 10e-6),
    ],
)
def test_a_bpm_of_the_library_does_not_depart_from_its_law(told, dither, steered):
    effects = build([parse_effect(f"{told},names=PM1B_C05")], LAYOUT, 1)
    record = simulate_record(
        RING, "x", 900, 5, effects, dither=dither, period=LAYOUT.period, steering_rms=steered
    )
    kind, place = all_effects()[told.partition(":")[0]], LAYOUT.bpms.names.index("PM1B_C05")
    start = {p.name: p.typical for p in kind.parameters}
    found = fit(Bench(record), (Cause(kind, (place,), start),))
    its = departure(Bench(record, found.causes), found.causes[0], found.gain)
    assert found.gain > 30.0
    assert its.nats < 0.02 * found.gain


def test_the_nearest_effect_of_another_law_is_told_from_it():
    its, gain = departs(OvershootsUpwards(np.array([COLUMN]), 0.6))
    assert "change" in its.course
    assert its.nats > 0.1 * gain
    assert its.chance < 0.01


class Follows(ColumnsEffect):
    """A law of no library: a part of the current comes slowly."""

    def __init__(self, places, size, kept):
        super().__init__(places)
        self._size, self._kept, self._slow, self._first = size, kept, None, None

    def follow(self, wanted):
        if self._slow is None:
            self._slow = self._first = wanted
        self._slow = self._kept * self._slow + (1.0 - self._kept) * wanted
        return wanted + self._size * (self._slow - self._first)


def test_a_member_that_stands_still_spoils_no_course():
    record = simulate_record(RING, "x", 300, 5, dither=2e-3, period=LAYOUT.period)
    setpoints = record.setpoints.copy()
    setpoints[:, COLUMN + 1] = 0.0
    still = replace(record, setpoints=setpoints)
    cause = Cause(all_effects()["corrector-gain"], (COLUMN, COLUMN + 1), {"gain": 0.1})
    assert all(np.isfinite(change).all() for _, change in trials(Bench(still, (cause,)), cause))


def test_a_course_is_worth_what_it_gains_once_the_law_is_fitted_anew():
    kept = np.exp(-1.0 / 5.0)
    true = Follows(np.array([COLUMN]), 0.3, kept)
    record = simulate_record(RING, "x", 700, 5, (true,), dither=2e-3, period=LAYOUT.period)
    nominal = Bench(record)
    (cause,) = fit(
        nominal, (Cause(all_effects()["corrector-gain"], (COLUMN,), {"gain": 0.1}),)
    ).causes
    bench = Bench(record, (cause,), nominal.floor)
    its = departure(bench, cause, 1e4)
    # Least squares of both courses at once, against the record without the cause.
    course = record.setpoints[:, COLUMN] - record.setpoints[0, COLUMN]
    slowly = lfilter([1.0 - kept], [1.0, -kept], course)
    each = [
        np.append(*nominal.unhealed(np.outer(its, LAYOUT.response[:, COLUMN])))
        for its in (course, slowly)
    ]
    left = np.append(nominal.white, nominal.sizes)

    def gain(*columns):
        matrix = np.array(columns)
        return 0.5 * (pull := matrix @ left) @ np.linalg.solve(matrix @ matrix.T, pull)

    price = np.log(len(list(trials(bench, cause)))) + 2.0
    assert its.course == "slowly, over 5 ticks"
    assert its.nats == pytest.approx(gain(*each) - gain(each[0]) - price, rel=0.02)


class Breathes(ColumnsEffect):
    """A law of no library: a gain that comes and goes."""

    def __init__(self, places, gain, cycle):
        super().__init__(places)
        self._gain, self._cycle, self._row, self._first = gain, cycle, 0, None

    def follow(self, wanted):
        self._first = wanted.copy() if self._first is None else self._first
        self._row += 1
        gain = self._gain * (1.0 - np.cos(2.0 * np.pi * self._row / self._cycle))
        return wanted + gain * (wanted - self._first)


def test_a_strength_that_comes_and_goes_is_told_from_one_that_stays():
    its, gain = departs(Breathes(np.array([COLUMN]), 0.3, 70.0))
    assert its.course == "with a strength that comes and goes"
    assert its.nats > 0.1 * gain
    assert its.chance < 0.01


class Leaks(ColumnsEffect):
    """A law of no library: what is set leaks away, slower than the record is long."""

    def __init__(self, places, ticks):
        super().__init__(places)
        self._ticks, self._held, self._first = ticks, None, None

    def follow(self, wanted):
        if self._held is None:
            self._held, self._first = wanted.copy(), wanted.copy()
        self._held = self._held + (wanted - self._held) / self._ticks
        return wanted - (self._held - self._first)


def test_a_kick_that_creeps_is_not_told_for_a_corrector_that_leaks():
    effects = [Leaks(np.array([COLUMN]), 1000.0)]
    record = simulate_record(RING, "x", 700, 5, effects, dither=2e-3, period=LAYOUT.period)
    kind = all_effects()["thermal-drift"]
    place = next(i for i, n in enumerate(kind.places_of(LAYOUT)) if n.startswith("CL1A_C05"))
    found = fit(Bench(record), (Cause(kind, (place,), {"rate": 1e-9, "tau": 60.0}),))
    its = departure(Bench(record, found.causes), found.causes[0], found.gain)
    assert its.nats > 0.1 * found.gain + 5.0
    assert its.chance < 0.1


class Hears(Effect):
    """A law of no library: a BPM hears its neighbour, through a filter."""

    def __init__(self, giver, taker):
        self._giver, self._taker, self._heard = giver, taker, 0.0

    def sense(self, orbit, tick):
        self._heard = 0.8 * self._heard + 0.2 * orbit[self._giver]
        told = orbit.copy()
        told[self._taker] += 0.5 * self._heard
        return told


def test_a_gain_is_not_told_for_a_bpm_that_hears_another():
    first = 20
    cells = LAYOUT.bpms.cells
    second = next(i for i in (19, 21) if cells[i] == cells[first])
    record = simulate_record(
        RING, "x", 700, 5, [Hears(second, first)], dither=2e-3, period=LAYOUT.period
    )
    kind = all_effects()["bpm-gain"]
    found = fit(Bench(record), (Cause(kind, (first,), {"gain": 0.1}),))
    its = departure(Bench(record, found.causes), found.causes[0], found.gain)
    assert its.course.startswith(f"as what {LAYOUT.bpms.label(second)} reads")
    assert its.chance < 0.1


def test_what_is_in_no_library_is_missed_most_where_little_is_seen():
    chances = [Departure("", 0.0, gain).chance for gain in (0.0, 10.0, 100.0, 1000.0)]
    assert chances == sorted(chances)
    for chance, missed in ((chances[0], 1.0), (chances[-1], UNTOLD)):
        odds = (1.0 - OUTSIDE) * (1.0 - AWRY) / (OUTSIDE * missed)
        assert chance == pytest.approx(odds / (1.0 + odds), abs=0.001)


@pytest.mark.parametrize("gain", [30.0, 300.0])
def test_the_more_is_gained_by_another_course_the_less_the_law_is_right(gain):
    shares = (0.0, 0.01, 0.05, 0.1, 0.3, 0.6)
    chances = [Departure("somehow", share * gain, gain).chance for share in shares]
    assert chances == sorted(chances, reverse=True)
    assert chances[0] > 0.85 > chances[1] > 0.6 > 0.2 > chances[4]
    assert [Departure("somehow", share * gain, gain).stand_in for share in shares[-2:]] == [
        False,
        True,
    ]


def test_more_than_a_twentieth_leaves_a_remainder_and_an_eighth_no_name():
    for gain in (200.0, 1000.0):
        assert Departure("somehow", 0.055 * gain, gain).chance < 0.5
        assert Departure("somehow", gain / 8.0, gain).chance < 0.1


def test_chances_are_shares_of_cases_that_are_drawn_so():
    """Bayes' rule by counting: laws that are right or not, and what departs from them."""
    rng, gain, count = np.random.default_rng(0), 200.0, 400_000
    missed = UNTOLD + 5.0 / gain
    outside = rng.random(count) < OUTSIDE
    departs = rng.random(count) < np.where(outside, 1.0 - missed, AWRY)
    mean = 1.0 + gain * np.where(outside, TOLD, IDEAL)
    nats = np.where(departs, rng.exponential(mean), 0.0)
    for low, high in ((0.0, 0.0), (2.0, 3.0), (15.0, 18.0), (40.0, 50.0)):
        here = (nats >= low) & (nats <= high)
        told = Departure("somehow" if high else "", 0.5 * (low + high), gain).chance
        assert told == pytest.approx(1.0 - np.mean(outside[here]), abs=0.03)


@pytest.mark.parametrize("harmonic", [0.0, 0.3])
def test_a_wave_may_have_harmonics(harmonic):
    kind = all_effects()["periodic-disturbance"]
    place = next(i for i, n in enumerate(kind.places_of(LAYOUT)) if n.startswith("QL2A_C17"))
    quiet = simulate_record(RING, "x", 700, 5, period=LAYOUT.period)
    turn = 2.0 * np.pi * 0.7 * quiet.time
    wave = 3e-8 * (np.cos(turn) + harmonic * np.cos(3.0 * turn + 0.5))
    orbit = wave[:, None] * kind.patterns(LAYOUT)[:, place]
    record = replace(quiet, readings=quiet.readings + orbit)
    start = {"frequency": 0.7, "cosine": 3e-8, "sine": 0.0}
    found = fit(Bench(record), (Cause(kind, (place,), start),))
    its = departure(Bench(record, found.causes), found.causes[0], found.gain)
    assert found.gain > 100.0
    assert its.chance > 0.8
