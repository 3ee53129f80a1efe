"""Neighbouring places that a record leaves open, and intervals that hold whichever it is."""

import numpy as np
import pytest

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.entry import Entry
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fit import fit
from orbitfb.diagnose.nearby import mixture_interval, nearby
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.build import Since, layout_of
from orbitfb.effects.registry import effect
from orbitfb.physics.places import Ring

KICK = 6e-8
ONSET = 200


def test_one_place_has_its_own_interval():
    low, high = mixture_interval(np.array([3.0]), np.array([2.0]), np.array([1.0]))
    assert low == pytest.approx(3.0 - 1.645 * 2.0, abs=1e-2)
    assert high == pytest.approx(3.0 + 1.645 * 2.0, abs=1e-2)


def test_two_places_alike_stretch_it_over_both():
    low, high = mixture_interval(np.array([0.0, 10.0]), np.ones(2), np.array([0.5, 0.5]))
    # 5 % of the whole lie below the 10 % quantile of the lower one
    assert low == pytest.approx(-1.2816, abs=1e-2)
    assert high == pytest.approx(11.2816, abs=1e-2)


@pytest.fixture(scope="module")
def found():
    """Kicks at the second quadrupole of a pair, each found at the first one."""
    return [around(seed) for seed in (1, 2, 3)]


def around(seed):
    ring, kind = Ring.load(), effect("local-kick")
    layout = layout_of(ring, "x", 0.1)
    names = kind.places_of(layout)
    true, beside = names.index("QM2B_C13 (x)"), names.index("QM1B_C13 (x)")
    rng = np.random.default_rng(0)
    made = kind.simulate(layout, np.array([true]), {"kick": KICK}, rng)
    begin = Since(made, 300 + ONSET, False)
    record = simulate_record(ring, ticks=400, seed=seed, effects=[begin], settle=300)
    bench = Bench(record)
    cause = Cause(kind, (beside,), {"kick": KICK}, ONSET)
    entry = Entry(Candidate(cause, 1.0, 1.0), fit(bench, (cause,)), 1.0)
    return true, nearby(bench, entry)


def test_the_true_place_is_among_the_neighbours(found):
    # Told with 95 %: of three, one may be missed.
    assert sum(true in its.places for true, its in found) >= 2


def test_the_interval_holds_wherever_it_is(found):
    held = [its.intervals["kick"][0] < KICK < its.intervals["kick"][1] for _, its in found]
    assert sum(held) >= 2


def test_what_is_no_source_has_no_neighbours():
    record = simulate_record(Ring.load(), ticks=100, seed=3)
    bench = Bench(record)
    cause = Cause(effect("bpm-gain"), (3,), {"gain": 0.1})
    assert nearby(bench, Entry(Candidate(cause, 1.0, 1.0), fit(bench, (cause,)), 1.0)) is None
