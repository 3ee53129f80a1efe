"""What a scan promises of devices that are struck together from a row on."""

from dataclasses import replace

import numpy as np
import pytest
from test_scans import CORRECTORS, LAYOUT, RING

from orbitfb.diagnose.bench import Bench, log_likelihood
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.scan import Scanner
from orbitfb.diagnose.scan_groups import Groups
from orbitfb.diagnose.scan_onsets import onsets
from orbitfb.diagnose.scan_shapes import Scoring
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.build import build
from orbitfb.effects.registry import all_effects
from orbitfb.effects.settings import parse_effect

SLOW, CRATE, ROW = 40, (40, 41), 448
LAG = {"tau": 0.05, "second": 1e-6}


@pytest.fixture(scope="module")
def steered() -> Bench:
    """One slow corrector in a ring that is steered once, and holds noise and drift otherwise."""
    effects = build([parse_effect(f"corrector-lag:tau=0.05s,names={CORRECTORS[SLOW]}")], LAYOUT, 1)
    record = simulate_record(
        RING, "x", 900, 5, effects, period=LAYOUT.period, steering=1, steering_rms=100e-6,
        regularisation=10e-6,
    )  # fmt: skip
    return Bench(record, ground="alone")


def gain_of(bench: Bench, cause: Cause) -> float:
    return log_likelihood(*bench.residual((cause,))) - bench.log_likelihood


def test_neighbours_hide_each_other_while_they_hold_the_orbit_and_not_when_it_is_steered(steered):
    kind, scoring = all_effects()["corrector-lag"], Scoring(steered)
    changes = scoring.changes(kind, LAG)
    groups = Groups.of(scoring, LAYOUT, kind, changes)
    found = [one for one in onsets(scoring, kind, LAG, changes, groups) if one.group]
    assert found
    for candidate in found:
        assert candidate.gain < gain_of(steered, candidate.cause) + 3.0
    parts = np.sum([np.diagonal(part) for part in groups.parts], axis=0)
    assert np.allclose(parts, groups.alone)


def test_a_group_promises_no_more_than_it_does(steered):
    kind = all_effects()["corrector-lag"]
    cause = Cause(kind, CRATE, LAG, ROW)
    grid = kind.grid(steered.record)
    promised = Candidate(cause, 1e4, 1.0, "a crate")
    measured = Scanner(steered)._measured(promised, grid)
    best = max(gain_of(steered, replace(cause, values=values)) for values in grid)
    assert 0.0 < measured.gain < best + 3.0
    single = Candidate(cause, 1e4, 1.0)
    assert Scanner(steered)._measured(single, grid) is single  # what it tells is no estimate


def test_a_change_that_tells_more_than_was_thought_is_smaller_and_gains_less(steered):
    kind = all_effects()["corrector-gain"]
    cause = Cause(kind, CRATE, {"gain": 0.01}, ROW)
    low, high = (gain_of(steered, replace(cause, values={"gain": g})) for g in (-0.01, 0.01))
    score, known = (high - low) / 0.02, -(high + low) / 0.01**2
    top, gain = score / known, 0.5 * score**2 / known
    assert gain > 1.0
    wrong = Candidate(replace(cause, values={"gain": 10.0 * top}), 10.0 * gain, 1.0, "a crate")
    measured = Scanner(steered)._measured(wrong, kind.grid(steered.record))
    assert measured.gain == pytest.approx(gain, rel=0.1)
    assert measured.cause.values["gain"] == pytest.approx(top, rel=0.1)
