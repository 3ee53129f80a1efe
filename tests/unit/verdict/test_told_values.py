"""Values of a cause, simulated tick by tick on a small ring, against their intervals."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.intervals import sized, told
from benchmarks.recover import draw
from benchmarks.small_ring import small_ring
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.refit import Course
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.impact.pieces import Piece
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.verdict.values import Measured
from orbitfb.effects.laws import DeviceLaw
from orbitfb.effects.registry import effect
from tests.unit.hypotheses.small_records import kinds_for, make_record

RING = small_ring()
TICKS = 1000
RANDOM = ("energy-drift", "noise-correlated", "bpm-walk")
"""A floor that was estimated without them has taken part of them."""
BETWEEN = (
    "bpm-nonlinearity",
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


def test_a_size_that_one_size_alone_explains_is_as_uncertain_as_the_other_is() -> None:
    """A curve that bends to one side saturates, too; where that hardly shows it is told alone."""
    case = draw(effect("bpm-nonlinearity"), 303, TICKS, RING)
    found = {one.parameter: one for one in told(sized(case), TICKS)}
    assert found["cubic"].value == 0.0
    assert found["cubic"].low is None
    assert found["quadratic"].spread > 0.1 * found["quadratic"].value


def test_what_devices_share_is_told_and_not_what_the_first_has() -> None:
    record = make_record(42)
    space = Workspace.of(record, kinds_for(record))
    kind = effect("corrector-lag")
    (law,) = kind.laws(space.signals)
    assert isinstance(law, DeviceLaw)
    values = {"tau": 0.1, "second": 1e-6}
    source = Course(law, (2, 3), values, np.ones(2))
    part = Candidate(kind, (2, 3), ("C2 (x)", "C3 (x)"), values, 30.0, sources=(source,))
    pieces = (Piece(("C2 (x)",), {**values, "tau": 0.3}, 0), Piece(("C3 (x)",), values, 0))
    assert Measured(Scorer.of(space)).values(kind, part, pieces)["tau"].value == 0.1


def test_no_frequency_of_a_device_is_better_known_than_its_law_is_right() -> None:
    case = draw(effect("corrector-resonance"), 1, TICKS, RING)
    found = {one.parameter: one for one in told(case, TICKS)}
    assert found["frequency"].spread == pytest.approx(0.05 * found["frequency"].value, rel=1e-3)


def test_a_value_of_which_the_record_says_nothing_has_no_interval() -> None:
    case = draw(effect("corrector-lag"), 1, TICKS, RING)
    alone = replace(case, values={"tau": 0.1, "second": 1e-6})
    found = {one.parameter: one for one in told(alone, TICKS)}
    assert found["tau"].inside
    assert found["second"].low is None
