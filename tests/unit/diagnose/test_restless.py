"""Gradients that are larger everywhere are the rival of a single one, and only then."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from orbitfb.diagnose.background import _gradient_scatters
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.entry import Entry, enter
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.restless import restless
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.build import layout_of
from orbitfb.effects.optics.gradients import ChangedGradients
from orbitfb.effects.registry import all_effects
from orbitfb.physics.places import Ring

RING = Ring.load()
LAYOUT = layout_of(RING, "x", 0.1)
QUADS, PLACE = np.arange(len(RING.places("QUAD"))), 40


def bench_of(sizes) -> Bench:
    """A shaken ring with gradient errors, in units of the usual scatter, that leave its tunes."""
    tunes = (RING.table.beta[:, RING.places("QUAD")] * _gradient_scatters(LAYOUT)).T
    sizes = sizes - tunes @ np.linalg.lstsq(tunes, sizes, rcond=None)[0]
    wrong = ChangedGradients(LAYOUT, QUADS, sizes * _gradient_scatters(LAYOUT))
    return Bench(simulate_record(RING, "x", 400, 5, (wrong,), dither=3e-3, period=LAYOUT.period))


def best(kind: str, weight: float, fitted: Any = None) -> Any:
    """What the search looks at of an entry."""
    return SimpleNamespace(kind=all_effects()[kind], weight=weight, fit=fitted)


@pytest.fixture(scope="module")
def everywhere() -> Bench:
    """Gradients that are three times as large as usual."""
    return bench_of(3.0 * np.random.default_rng(4).standard_normal(len(QUADS)))


def test_gradients_that_are_larger_everywhere_explain_more_than_one_of_them(everywhere):
    found = restless(everywhere, best("quadrupole-gradient", 10.0))
    assert found is not None and found.layout.restless > 1.0
    assert np.mean(Bench(found).sizes ** 2) < np.mean(everywhere.sizes**2)
    assert restless(Bench(found), best("quadrupole-gradient", 10.0)) is None  # once is enough


def test_they_are_no_rival_of_what_explains_more_or_of_another_effect(everywhere):
    assert restless(everywhere, best("sextupole", 1e5)) is None
    assert restless(everywhere, best("corrector-gain", 10.0)) is None
    assert restless(everywhere, None) is None


def entry_of(bench: Bench, gradient: float) -> Entry:
    kind = all_effects()["quadrupole-gradient"]
    cause = Cause(kind, (PLACE,), {"gradient": gradient})
    return enter(bench, Candidate(cause, 0.0, float(len(QUADS))))


def test_a_cause_pays_for_its_choice_and_may_be_there_in_a_restless_ring_too():
    sizes = 1.5 * np.random.default_rng(4).standard_normal(len(QUADS))
    bench = bench_of(sizes + 40.0 * np.eye(len(QUADS))[PLACE])
    entry = entry_of(bench, 1e-4)
    # larger gradients everywhere by themselves explain less than the cause gains
    assert restless(bench, best(entry.kind.id, entry.gain)) is None
    found = restless(bench, entry)
    assert found is not None and found.layout.restless == 1.5
    assert 0.0 < entry_of(Bench(found), 1e-4).weight < 0.5 * entry.weight


@pytest.mark.parametrize("size", [0.0, 40.0])
def test_one_large_gradient_and_usual_ones_are_no_restless_ring(size):
    sizes = np.random.default_rng(4).standard_normal(len(QUADS))
    bench = bench_of(sizes + size * np.eye(len(QUADS))[PLACE])
    entry = entry_of(bench, 1e-4)
    assert entry.gain > 0.5 * size
    assert restless(bench, entry) is None
