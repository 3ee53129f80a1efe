"""Laws that amount to a simpler one in what a record holds."""

import pytest
from gap_cases import bench
from test_scans import CORRECTORS, record_with

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.rounds import Round
from orbitfb.diagnose.tournament import tournament
from orbitfb.effects.registry import all_effects

KINDS = [all_effects()[name] for name in ("corrector-gain", "corrector-hysteresis")]


def round_on(there):
    entries = tournament(there, KINDS)
    return Round(there, tuple(entries), len(KINDS), entries[0])


def test_a_play_wider_than_all_that_a_corrector_did_is_a_gain_error():
    found = round_on(bench(with_error=True))
    first, second = found.entries[:2]
    assert (first.kind.id, first.limit_of) == ("corrector-gain", "")
    assert (second.kind.id, second.limit_of) == ("corrector-hysteresis", "corrector-gain")
    assert second.weight <= first.weight
    assert found.rivals() == []
    assert found.limits() == ("corrector-hysteresis",)


@pytest.mark.parametrize("width", [2e-3, 2e-2])
def test_a_play_within_the_moves_of_a_corrector_is_a_law_of_its_own(width):
    effect = f"corrector-hysteresis:width={width},share=1,names={CORRECTORS[20]}"
    found = round_on(Bench(record_with(effect, dither=1e-2)))
    assert found.accepted.kind.id == "corrector-hysteresis"
    assert not any(entry.limit_of for entry in found.entries)
    assert found.limits() == ()


def test_a_resonance_that_has_settled_when_the_orbit_is_read_is_a_lag():
    kinds = [all_effects()[name] for name in ("corrector-lag", "corrector-resonance")]
    effect = f"corrector-resonance:frequency=13Hz,damping=0.4,names={CORRECTORS[20]}"
    there = Bench(record_with(effect, dither=1e-2))
    entries = tournament(there, kinds)
    found = Round(there, tuple(entries), len(kinds), entries[0])
    assert found.accepted.kind.id == "corrector-lag"
    assert found.limits() == ("corrector-resonance",)


def test_a_little_delay_of_the_loop_may_be_a_lag_of_all_correctors():
    kinds = [all_effects()[name] for name in ("loop-delay", "corrector-lag")]
    there = Bench(record_with("loop-delay:ticks=0.02", dither=1e-3))
    found = Round(there, entries := tuple(tournament(there, kinds)), len(kinds), entries[0])
    assert found.accepted.kind.id == "loop-delay"
    assert found.rivals() == []  # one of 180 correctors, of a cell or of all: it pays for that
    assert found.limits() == ("corrector-lag",)
