"""A law that is another one in an extreme gives way to that other one."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.refit import Course
from orbitfb.diagnose.result.diagnosis import Diagnosis
from orbitfb.diagnose.selection.proper import proper
from orbitfb.diagnose.verdict.engine import diagnose
from orbitfb.effects.laws import Signals
from orbitfb.effects.registry import effect
from orbitfb.records.record import Record
from tests.unit.hypotheses.small_records import make_record, remembered


def tripped(seed: int) -> Record:
    """Corrector 7 loses its current in row 300."""
    row = [0]

    def step(state: Vector, wanted: Vector) -> Vector:
        row[0] += 1
        acting = wanted.copy()
        acting[7] *= row[0] < 300
        return acting

    return make_record(seed, remembered(step))


def lag_of_two(state: Vector, wanted: Vector) -> Vector:
    """Correctors 5 and 6 lack half of every step a row later."""
    acting = wanted.copy()
    acting[5:7] = 0.5 * (state + wanted)[5:7]
    return acting


def candidate(name: str, values: dict[str, float], evidence: float, record: Record) -> Candidate:
    kind = effect(name)
    law, *_ = kind.laws(Signals(record, record.setpoints, record.readings))
    source = Course(law, (7,), values, np.ones(1), 300)  # type: ignore[arg-type]
    return Candidate(kind, (7,), ("C7 (x)",), values, evidence, onset=300, sources=(source,))


@pytest.mark.parametrize(("behind", "first"), [(2.0, "corrector-stuck"), (900.0, "corrector-slew")])
def test_the_simpler_law_stays_alone_where_it_is_a_rival(behind: float, first: str) -> None:
    record = make_record(1)
    signals = Signals(record, record.setpoints, record.readings)
    slew = candidate("corrector-slew", {"rate": 1e-5}, 1000.0, record)
    stuck = candidate("corrector-stuck", {"left": 1.0}, 1000.0 - behind, record)

    told = proper([slew, stuck], signals)

    assert told[0].kind.id == first
    assert len(told) == (2 if told[0] is slew else 1)
    true = replace(slew, sources=(replace(slew.sources[0], values={"rate": 0.05}),))
    assert proper([true, stuck], signals) == [true, stuck]


def told(record: Record, *without: str) -> Diagnosis:
    return diagnose(record, seed=0, without=frozenset(without), progress=lambda what, share: None)


def test_what_is_left_out_of_the_library_is_not_its_like_in_an_extreme() -> None:
    """A trip is a limit that nothing gets below, and a lag a resonance that does not ring."""
    trip = told(tripped(2), "corrector-stuck")
    assert trip.state == "unknown"
    assert trip.unknown is not None
    assert trip.unknown.places == ("C7 (x)",)
    assert "the current never moves" in trip.unknown.text
    lag = told(make_record(3, remembered(lag_of_two)), "corrector-lag", "bpm-lowpass")
    assert lag.state == "unknown"
    assert lag.unknown is not None
    assert lag.unknown.nearest == "corrector-resonance"
    assert "nothing overshoots" in lag.unknown.text
