"""In an extreme a law is another one: what a record would show of it is told to be lacking."""

from dataclasses import replace

import numpy as np
import pytest
from actuator_courses import record_of

from orbitfb.effects.laws import Signals
from orbitfb.effects.registry import effect

WANTED = 0.01 * np.cumsum(np.random.default_rng(3).standard_normal((400, 180)), axis=0)[:, :3]
"""Setpoints that wander by some tenths of an ampere, each step a hundredth."""


@pytest.mark.parametrize(
    ("name", "values", "lacks"),
    [
        ("corrector-slew", {"rate": 0.05}, ""),
        ("corrector-slew", {"rate": 1e-4}, "never moves"),
        ("corrector-deadband", {"width": 0.02}, ""),
        ("corrector-deadband", {"width": 9.0}, "less than twice"),
        ("corrector-saturation", {"limit": 0.1, "side": 0.0, "rounding": 1e-6}, ""),
        ("corrector-saturation", {"limit": 1e-4, "side": 0.0, "rounding": 1e-6}, "never moves"),
        ("corrector-hysteresis", {"width": 0.03, "share": 0.5}, ""),
        ("corrector-hysteresis", {"width": 0.5, "share": 0.1}, "never crosses"),
        ("corrector-resonance", {"frequency": 2.0, "damping": 0.3}, ""),
        ("corrector-resonance", {"frequency": 0.02, "damping": 0.3}, ""),  # overshoots in row 262
        ("corrector-resonance", {"frequency": 2.0, "damping": 0.98}, "nothing overshoots"),
        ("corrector-resonance", {"frequency": 1e5, "damping": 0.98}, ""),
        ("corrector-stuck", {"left": 1.0}, ""),
        ("corrector-gain", {"gain": -1.0}, "never moves"),
        ("corrector-gain", {"gain": -0.8}, ""),
    ],
)
def test_a_corrector_in_an_extreme_lacks_what_its_law_does(layout, name, values, lacks):
    record = record_of(layout, np.tile(WANTED, (1, 60)))
    told = effect(name).lacks(WANTED, values, record)
    assert lacks in told
    assert bool(told) == bool(lacks)


def test_every_law_that_may_be_another_one_says_so_to_the_engine(layout):
    """Since a row, of the devices that it strikes."""
    record = record_of(layout, np.tile(WANTED, (1, 60)))
    given = Signals(record, record.setpoints, record.readings)
    (law,) = effect("corrector-saturation").laws(given)
    assert law.lacks is not None
    limit = float(np.abs(WANTED[:, 1]).max()) - 1e-9
    values = {"limit": limit, "side": 0.0, "rounding": 1e-6}
    alone = law.some(given, np.array([1]))
    assert not law.lacks(values, alone, 100)
    late = int(np.argmax(np.abs(WANTED[:, 1])))
    assert "never moves" in law.lacks({**values, "limit": 1e-5}, alone, late // 2)


@pytest.mark.parametrize(("period", "lacks"), [(12.0, False), (35.0, True)])
def test_a_current_that_comes_back_once_is_a_jump(layout, period, lacks):
    record = record_of(layout, np.tile(WANTED, (1, 60)))  # 40 s
    kind = effect("bpm-current")
    values = {"slope": 2e-4, "period": period, "first": 5.0}
    assert bool(kind.lacks(values, record)) == lacks
    known = replace(record, auxiliary={"current": np.linspace(0.5, 0.49, len(record))})
    assert not kind.lacks(values, known)
