"""Rows that are struck, alone and one after the other."""

import numpy as np
import pytest

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses import events
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.scan import candidates_of
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.records.record import Record
from tests.unit.hypotheses.small_records import kinds_for, make_record, remembered

SHARE = 0.15


def losing(seed: int) -> Record:
    """A loop whose setpoints are lost now and then, all of them at once."""
    rng = np.random.default_rng(seed)

    def step(state: Vector, row: Vector) -> Vector:
        return state if rng.random() < SHARE else row

    return make_record(11, remembered(step))


def best(record: Record) -> Candidate:
    kinds = [kind for kind in kinds_for(record) if kind.id == "missed-write"]
    return candidates_of(Workspace.of(record, kinds_for(record)), kinds)[0]


def test_writes_that_are_missed_in_a_row_are_told_as_such(monkeypatch: pytest.MonkeyPatch) -> None:
    """One in seven that are missed follows another one: the plant then holds an older set."""
    record = losing(5)

    whole = best(record)
    monkeypatch.setattr(events, "STRUCK_RUN", 1)
    single = best(record)

    assert whole.values["probability"] == pytest.approx(SHARE, rel=0.25)
    assert whole.evidence > single.evidence + 100.0
