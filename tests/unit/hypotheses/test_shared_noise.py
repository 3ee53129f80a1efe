"""Noise that BPMs have in common, whoever they are, and what a random cause's spectrum tells."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.noise.shared import shared_noise
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.search import search
from orbitfb.effects.registry import effect
from orbitfb.estimation.priors import SURE
from orbitfb.records.record import Record
from tests.unit.hypotheses.small_records import kinds_for, make_record


def with_noise(seed: int, course: Vector, signs: dict[int, float]) -> Record:
    """Some BPMs read a course besides, each with its sign."""
    record = make_record(seed, gain=0.2)
    readings = record.readings.copy()
    readings[:, list(signs)] += course[: len(record), None] * list(signs.values())
    return replace(record, readings=readings)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_bpms_with_noise_in_common_are_found_wherever_they_are(seed: int) -> None:
    course = 0.2e-6 * np.random.default_rng(seed).standard_normal(2000)
    record = with_noise(seed, course, {2: 1.0, 7: -1.0, 13: 1.0})

    told = shared_noise(Workspace.of(record, kinds_for(record)))

    assert told.evidence > SURE
    assert set(told.names) == {"B2 (x)", "B7 (x)", "B13 (x)"}


@pytest.mark.parametrize("seed", range(4, 10))
def test_bpms_without_have_none(seed: int) -> None:
    record = make_record(seed, gain=0.2)
    told = shared_noise(Workspace.of(record, kinds_for(record)))
    assert told.evidence < 6.0
    assert len(told.names) == 2


@pytest.mark.parametrize(("walks", "other"), [(False, True), (True, False)])
def test_a_walk_that_is_none_has_another_spectrum(walks: bool, other: bool) -> None:
    course = 0.4e-6 * np.random.default_rng(5).standard_normal(2000)
    record = with_noise(
        6, 0.2 * course.cumsum() if walks else course, dict.fromkeys(range(4, 8), 1.0)
    )

    accepted, found = search(Workspace.of(record, kinds_for(record)), [effect("bpm-walk")])

    told = [one.evidence for one in found[-1].free if one.target == "spectrum"]
    assert [one.kind.id for one in accepted] == ["bpm-walk"]
    assert (max(told) > SURE) == other
