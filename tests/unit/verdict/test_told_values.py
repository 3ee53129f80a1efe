"""Values of a cause, simulated tick by tick on a small ring, against their intervals."""

from dataclasses import replace

import pytest

from benchmarks.intervals import sized, told
from benchmarks.recover import draw
from benchmarks.small_ring import small_ring
from orbitfb.effects.registry import effect

RING = small_ring()
TICKS = 1000
RANDOM = ("energy-drift", "noise-correlated", "bpm-walk")
"""A floor that was estimated without them has taken part of them."""
BETWEEN = (
    "clock-jitter",
    "corrector-lag",
    "corrector-resonance",
    "noise-level",
    "noise-tails",
    "telegraph",
)
"""Their true values lie between those that are scanned; some have two."""
NARROW = ("corrector-hysteresis", "corrector-saturation", "corrector-slew", "energy-offset")
"""The record tells them to a tenth and better."""


@pytest.mark.parametrize("name", [*RANDOM, *BETWEEN, *NARROW])
def test_every_value_is_told_within_three_standard_deviations(name: str) -> None:
    found = list(told(sized(draw(effect(name), 1, TICKS, RING)), TICKS))
    assert found
    for one in found:
        if one.parameter != "side":  # that is a choice
            assert one.low is not None
            assert abs(one.value - one.true) < 3.0 * one.spread, one


@pytest.mark.parametrize("name", NARROW)
def test_a_value_that_shows_has_a_narrow_interval(name: str) -> None:
    size = effect(name).linear or effect(name).parameters[0].name
    found = list(told(draw(effect(name), 1, TICKS, RING), TICKS))
    assert [one.spread < 0.1 * one.value for one in found if one.parameter == size] == [True]


@pytest.mark.parametrize(("seed", "within"), [(1, 0.02), (2, 0.0)])
def test_a_current_that_stays_is_all_that_was_there(seed: int, within: float) -> None:
    """And nothing else, in a loop that runs away with it."""
    case = draw(effect("corrector-stuck"), seed, TICKS, RING)
    frozen = replace(case, values={"left": 1.0, "decay": 1e-9})
    found = [one.value for one in told(frozen, TICKS) if one.parameter == "left"]
    assert found == [pytest.approx(1.0, abs=within)]


def test_a_value_of_which_the_record_says_nothing_has_no_interval() -> None:
    case = draw(effect("corrector-lag"), 1, TICKS, RING)
    alone = replace(case, values={"tau": 0.1, "second": 1e-6})
    found = {one.parameter: one for one in told(alone, TICKS)}
    assert found["tau"].inside
    assert found["second"].low is None
