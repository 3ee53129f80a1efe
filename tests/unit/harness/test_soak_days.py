"""The soak over days knows the energy that it asks the loop to keep."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.physics.places import Ring
from tests.soak import surroundings
from tests.soak.days import Energy, live
from tests.soak.surroundings import DAY, Surroundings

GOOD = Energy(7.0, True, 2e-6, 1e-6, 0.004, 2e-7, 1000, 0.3, 8.0, 1400, 0, 0, "")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"largest": 1.1e-5}, "energy deviation"),
        ({"largest": float("nan")}, "energy deviation"),
        ({"largest_step": 5.1}, "a step"),
        ({"trips": 1}, "TRIPPED"),
        ({"not_closed": 1}, "not CLOSED"),
        ({"reason": "the beam does not answer"}, "does not follow"),
    ],
)
def test_what_is_not_as_it_must_be_is_told(change, words):
    assert GOOD.problems() == []
    [told] = replace(GOOD, **change).problems()
    assert words in told


def test_the_energy_that_is_known_is_that_in_the_orbit(monkeypatch):
    """With kicks that bend alone and no betatron motion, the orbit is the dispersion times it."""
    for name in ("GROUND", "GAP_KICK", "DAY_KICK"):
        monkeypatch.setattr(surroundings, name, 0.0)
    ring = Ring.load()
    its = Surroundings(ring, 600.0, 1)
    orbit = its.disturb(np.zeros(180), round(DAY / 4 / 600.0))
    dispersion = ring.table.dispersion[ring.places("BPM", "x")]
    assert abs(its.energy) > 1e-5
    np.testing.assert_allclose(orbit, dispersion * its.energy, atol=1e-12)


def test_gaps_move_and_kick(monkeypatch):
    monkeypatch.setattr(surroundings, "GROUND", 0.0)
    its = Surroundings(Ring.load(), 60.0, 1)
    for tick in range(1440):
        its.disturb(np.zeros(180), tick)
    assert 100 < its.moves < 300  # of ten devices, 20 a day each


@pytest.mark.parametrize("follows", [True, pytest.param(False, marks=pytest.mark.nightly)])
def test_the_frequency_keeps_the_energy_that_the_tide_takes(monkeypatch, follows):
    """A tide fifty times as quick, so that five minutes are enough.

    At a hundred times the drift cancels what the loop asks for: it waits, and the energy goes.
    """
    monkeypatch.setattr(surroundings, "TIDE_PERIOD", surroundings.TIDE_PERIOD / 50)
    _, energy = live(300 / 86400, rate=1.0, follows=follows)
    told = energy.problems()
    assert (not told) is follows, told
