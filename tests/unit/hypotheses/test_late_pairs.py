"""Pairs of correctors that are exchanged, coupled or rolled in the middle of a record."""

from dataclasses import replace

import pytest

from benchmarks.recover import columns_of, draw, record_of
from benchmarks.small_ring import small_ring
from orbitfb.diagnose.hypotheses.pairs import scan_pairs
from orbitfb.diagnose.hypotheses.scan import candidates_of
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.laws import PairLaw
from orbitfb.effects.registry import all_effects, effect

RING = small_ring()
TICKS, ROW = 600, 350


@pytest.mark.parametrize("name", ["corrector-swap", "corrector-crosstalk", "corrector-roll"])
def test_a_pair_begins_at_its_row(name: str) -> None:
    kind = effect(name)
    case = replace(draw(kind, 1, TICKS, RING), onset=ROW)
    record = record_of(case, TICKS)
    healthy = [
        one for one in all_effects().values() if one.healthy_scatter(record.layout) is not None
    ]
    space = Workspace.of(record, [*healthy, kind])
    found = [one for one in candidates_of(space, [kind]) if one.kind is kind]
    best = found[0]
    struck = columns_of(kind, case.places, record.layout)
    assert set(best.places) == {int(one) for one in struck}
    assert abs(best.onset - ROW) <= 1
    assert best.evidence > 2.0 * max(one.evidence for one in found if not one.onset)


def test_of_a_healthy_record_no_pair_begins_late() -> None:
    record = record_of(
        replace(draw(effect("corrector-roll"), 2, TICKS, RING), values={"angle": 0.0}), TICKS
    )
    kind = effect("corrector-roll")
    space = Workspace.of(record, [effect("corrector-gain"), effect("bpm-gain"), kind])
    (law,) = space.courses.laws(kind)
    assert isinstance(law, PairLaw)
    assert not [one for one in scan_pairs(kind, law, Scorer.of(space)) if one.onset or one.finer]
