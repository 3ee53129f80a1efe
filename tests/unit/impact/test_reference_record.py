"""A record of a healthy time is what another one is compared with; both planes are told apart."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.diagnose.result.diagnosis import Diagnosis
from orbitfb.diagnose.verdict.engine import diagnose
from orbitfb.physics.optics import Matrix
from orbitfb.records.layout import Devices
from orbitfb.records.record import Record
from tests.unit.hypotheses.small_records import Bent, make_record


def answer(record: Record, reference: Record | None) -> Diagnosis:
    return diagnose(record, reference, None, seed=0, progress=lambda what, share: None)


def wandering(currents: Matrix) -> Matrix:
    """Corrector 9 wanders from row 450 on."""
    walk = 0.006 * np.random.default_rng(8).standard_normal(901)
    kicked = currents[-1:].copy()
    kicked[0, 9] += walk[450 : len(currents)].sum()
    return kicked


def scattered(share: float) -> Bent:
    gains = 1.0 + share * np.random.default_rng(1).standard_normal(12)
    return lambda currents: currents[-1:] * gains


@pytest.mark.nightly
def test_ground_that_wanders_more_than_at_the_healthy_time_shows_more_clearly() -> None:
    whole = make_record(24, currents=wandering)
    before, after = whole.rows(0, 450), whole.rows(450, 900)
    with_it, without = answer(after, before), answer(after, None)
    assert with_it.causes[0].places == ("C9",)
    evidence = [one.causes[0].evidence_nats or 0.0 if one.causes else 0.0
                for one in (without, with_it)]  # fmt: skip
    assert evidence[1] > 2.0 * evidence[0]


def test_errors_that_the_healthy_time_had_too_are_no_cause() -> None:
    whole = make_record(31, currents=scattered(0.08))
    before, after = whole.rows(0, 450), whole.rows(450, 900)
    assert answer(after, None).causes[0].effect == "corrector-gain"
    assert answer(after, before).state == "no_gap"


def test_both_planes_are_diagnosed_at_once_and_missing_readings_do_no_harm() -> None:
    def reversed_fourth(currents: Matrix) -> Matrix:
        kicked = currents[-1:].copy()
        kicked[:, 4] *= -1.0
        return kicked

    record = make_record(23, currents=reversed_fourth, gain=0.0, rows=500)
    names = tuple(f"B{number // 2}" for number in range(16))
    planes = ("x", "y") * 8
    filled = record.filled.copy()
    readings = record.readings.copy()
    filled[100:103, 5] = True
    readings[100:103, 5] = np.linspace(readings[99, 5], readings[103, 5], 5)[1:4]
    layout = replace(record.layout, bpms=Devices(names, planes, ("",) * 16))
    found = answer(replace(record, layout=layout, readings=readings, filled=filled), None)
    assert found.causes[0].effect == "corrector-polarity"
    assert found.causes[0].places == ("C4",)
    assert found.gap is not None
    assert "B3 (y)" in found.gap.by_bpm
    assert found.provenance.planes == "xy"
    assert found.shrink is not None
    assert found.shrink.um == pytest.approx(1.0, abs=0.1)
