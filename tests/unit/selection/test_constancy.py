"""A cause that comes and goes is told from one that stays: loops whose correctors lag."""

import pytest

from orbitfb.core.signals import Vector
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.search import search
from orbitfb.diagnose.verdict.state import Judged
from orbitfb.diagnose.verdict.unknown import unknown_of
from orbitfb.effects.registry import effect
from orbitfb.estimation.priors import SURE
from orbitfb.records.record import Record
from tests.unit.hypotheses.small_records import (
    early,
    kinds_for,
    lagging,
    make_record,
    remembered,
)


def lagging_now_and_then(kept: float, every: int) -> Record:
    """All correctors lag in 50 rows of so many, and follow at once in the others."""
    row = [0]

    def step(state: Vector, wanted: Vector) -> Vector:
        row[0] += 1
        late = row[0] % every < 50
        return state + (1.0 - kept * late) * (wanted - state)

    return make_record(3, remembered(step))


@pytest.mark.parametrize(("every", "varies"), [(150, True), (0, False)])
def test_a_cause_that_comes_and_goes_is_not_all_that_is_so(every: int, varies: bool) -> None:
    record = lagging_now_and_then(0.1, every) if every else make_record(3, lagging(0.1))

    accepted, found = search(Workspace.of(record, kinds_for(record)), [effect("corrector-lag")])

    told = [one.evidence for one in found[-1].free if one.target == "varying"]
    assert [one.kind.id for one in accepted] == ["corrector-lag"]
    assert len(told) == 2
    assert (max(told) > SURE) == varies
    assert max(told) > SURE or max(told) < 0.0
    unknown = unknown_of(Judged("named_plus_remainder", found[-1].unknown, max(told)), ())
    assert unknown is not None
    assert ("it comes and goes" in unknown.text) == varies


def test_what_strikes_at_random_is_never_the_same() -> None:
    """Its course was told of the record, and has less than all of what it does."""
    record = early(8, 0.15)

    accepted, found = search(Workspace.of(record, kinds_for(record)), [effect("clock-jitter")])

    assert [one.kind.id for one in accepted] == ["clock-jitter"]
    assert not [one for one in found[-1].free if one.target == "varying"]
