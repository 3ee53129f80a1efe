"""What causes are worth, the scores over the ring, and the slices that show them."""

from dataclasses import replace

import numpy as np
import pytest
from gap_cases import GAIN, PLACE, bench, gain_error, record

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.entry import Entry
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fingerprints import fingerprints
from orbitfb.diagnose.gap import gap
from orbitfb.diagnose.rounds import Round
from orbitfb.diagnose.score_map import score_map
from orbitfb.diagnose.search import Outcome
from orbitfb.diagnose.shrink import contrast
from orbitfb.diagnose.worth import Gains, Worths, waterfall
from orbitfb.effects.registry import effect

CAUSES = (gain_error(), gain_error(40, 0.02))
"""The first one is there, the second one is not."""


@pytest.fixture(scope="module")
def outcome():
    last = Bench(record(True), CAUSES)
    entries = [Entry(Candidate(cause, 10.0, 1.0), None, 10.0) for cause in CAUSES]
    nominal = bench(True)
    rounds = [Round(nominal, tuple(entries), 2, entry) for entry in entries]
    return Outcome(tuple(rounds), None, last, CAUSES)


def test_the_true_cause_has_the_gain_and_the_other_has_none(outcome):
    worths = Worths(outcome, Gains(outcome.bench))
    entry = outcome.rounds[0].entries[0]
    shares = [worths.share(cause, entry) for cause in outcome.bench.causes]
    assert sum(shares) == pytest.approx(1.0)
    assert shares[0] > 0.95
    lost = [worths.lost_without(cause, entry) for cause in outcome.bench.causes]
    assert lost[0] > 20.0
    assert abs(lost[1]) < 5.0


def test_an_effect_without_a_course_in_time_has_the_gain_of_its_scan(outcome):
    kind = effect("noise-tails")
    entry = Entry(Candidate(Cause(kind, (0,), {}), 30.0, 1.0), None, 30.0)
    more = replace(outcome.rounds[0], accepted=entry)
    both = replace(outcome, rounds=(*outcome.rounds, more))
    worths = Worths(both, Gains(outcome.bench))
    assert worths.lost_without(entry.cause, entry) == 30.0
    assert 0.0 < worths.share(entry.cause, entry) < 0.5


def test_the_waterfall_ends_where_the_causes_leave_the_gap(outcome):
    gains = Gains(outcome.bench)
    its = gap(outcome.bench, gains=gains)
    later = contrast(outcome.bench, record(True, seed=6))
    steps = waterfall(outcome, gains, its.nats_per_tick, later)
    assert [step.label for step in steps] == ["nominal", "+ corrector-gain", "+ corrector-gain"]
    assert steps[0].fit == its.nats_per_tick
    assert steps[-1].fit == pytest.approx(0.0, abs=1e-6)
    assert steps[1].held_out < 0.2 * steps[0].held_out
    assert waterfall(outcome, gains, its.nats_per_tick, None)[1].held_out is None


def test_the_score_is_highest_where_the_cause_is(outcome):
    its = score_map(replace(outcome, causes=CAUSES[:1]))
    (actuator,) = [row for row in its.rows if row.stage == "actuator"]
    assert int(np.argmax(actuator.gain)) == PLACE
    assert actuator.fitted == (PLACE,)
    assert actuator.gain[PLACE] > its.threshold_nats
    assert len(actuator.s_m) == len(actuator.names) == len(actuator.gain)
    assert {row.stage for row in its.rows} >= {"sensor", "optics"}


def test_the_score_of_one_place_is_what_a_fit_of_its_size_gains(outcome):
    nominal = outcome.rounds[0].bench
    row, *_ = score_map(replace(outcome, causes=CAUSES[:1])).rows
    sizes = np.linspace(0.0, 0.5, 26)
    gains = [
        -0.5 * (np.sum(white**2) + np.sum(its**2) - np.sum(nominal.white**2))
        + 0.5 * np.sum(nominal.sizes**2)
        for white, its, _ in (nominal.residual([gain_error(size=size)]) for size in sizes)
    ]
    assert row.gain[PLACE] == pytest.approx(max(gains), rel=0.25)


def test_a_fingerprint_shows_the_gain(outcome):
    first, _ = fingerprints(outcome.bench)
    assert first.x_label == "change of the setpoint [mA]"
    pull = np.abs(np.subtract(first.measured, first.refit)) / np.array(first.error)
    assert pull.max() < 5.0
    assert np.mean(pull**2) < 3.0
    slope = np.polyfit(first.x, first.measured, 1)[0]
    assert slope == pytest.approx(GAIN, rel=0.25)
    assert not any(first.nominal)
