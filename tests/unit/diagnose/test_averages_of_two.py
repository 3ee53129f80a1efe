"""A BPM whose readings average two noisy samples, told from one that averages many."""

from dataclasses import replace

import numpy as np
import pytest
from test_scans import BPMS, best, record_with

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.entry import enter
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fit import fit
from orbitfb.diagnose.rounds import Round
from orbitfb.diagnose.tournament import tournament
from orbitfb.effects.registry import all_effects

KINDS = [all_effects()[name] for name in ("bpm-latency", "bpm-lowpass", "noise-coloured")]
NAME = f"names={BPMS[20]}"


def round_on(record):
    there = Bench(record)
    entries = tournament(there, KINDS)
    return Round(there, tuple(entries), len(KINDS), entries[0])


@pytest.mark.parametrize("ticks", [0.3, 0.7])
def test_an_average_of_two_samples_is_no_average_of_many(ticks):
    effect = f"bpm-latency:ticks={ticks},resampled=1,{NAME}"
    found = round_on(record_with(effect, dither=0.0))
    cause = found.accepted.cause
    assert (cause.kind.id, cause.places, cause.onset) == ("bpm-latency", (20,), 0)
    assert cause.values["resampled"] == 1.0
    low, high = found.accepted.fit.interval(0)
    assert low < ticks < high < low + 0.2
    lowpass = max(one.weight for one in found.entries if one.kind.id == "bpm-lowpass")
    assert found.accepted.weight > lowpass + 5.0
    assert found.rivals() == []


@pytest.mark.parametrize(
    ("effect", "dither", "values"),
    [
        ("bpm-lowpass:tau=0.1s", 0.0, {}),
        ("bpm-lowpass:tau=0.1s", 1e-4, {}),
        ("bpm-lowpass:tau=0.05s", 3e-4, {}),
        ("bpm-lowpass:tau=0.05s", 2e-3, {}),
        ("bpm-latency:ticks=0.3,resampled=1", 3e-4, {"resampled": 1.0}),
        ("bpm-latency:ticks=0.3", 3e-4, {"resampled": 0.0}),
        ("bpm-latency:ticks=0.7", 0.0, {"resampled": 0.0}),
        ("bpm-latency:ticks=2", 3e-4, {"resampled": 0.0}),
    ],
)
def test_an_average_of_many_and_an_orbit_that_is_sampled_late_keep_their_names(
    effect, dither, values
):
    found = round_on(record_with(f"{effect},{NAME}", dither=dither))
    cause = found.accepted.cause
    assert (cause.kind.id, cause.places) == (effect.split(":")[0], (20,))
    assert {name: cause.values[name] for name in values} == values
    assert found.rivals() == []


def test_an_average_shows_in_a_record_that_nobody_shook():
    found = best(record_with(f"bpm-latency:ticks=0.3,resampled=1,{NAME}", dither=0.0), KINDS[0].id)
    assert (found.cause.places, found.cause.values["resampled"]) == ((20,), 1.0)
    assert found.gain > 50.0


def test_where_a_part_of_a_tick_explains_the_record_an_average_is_tried():
    bench = Bench(record_with(f"bpm-latency:ticks=0.3,resampled=1,{NAME}", dither=0.0))
    sampled = Cause(KINDS[0], (20,), {"ticks": 0.3})
    entry = enter(bench, Candidate(sampled, 30.0, 1.0))
    assert entry.cause.values["resampled"] == 1.0


def test_a_right_law_leaves_no_more_noise_than_it_expects_however_loud_the_bpm_was_without_it():
    """What it leaves is told over the level that it leaves itself."""
    there = Bench(record_with(f"bpm-lowpass:tau=0.05s,{NAME}", dither=2e-3))
    found = fit(there, (Cause(all_effects()["bpm-lowpass"], (20,), {"tau": 0.04}),))
    assert there.granted(found.causes, found.white) > 1000.0
    assert found.inflation < 1.1


def test_bpms_that_differ_in_noise_speak_for_no_law_of_all_of_them():
    """How loud each is a law with free levels tells; others are not charged with it."""
    record = record_with("loop-delay:ticks=0.1", dither=1e-4)
    rng = np.random.default_rng(2)
    louder = 0.8 * rng.uniform(0.0, 1.0, record.readings.shape[1])
    noise = 0.2e-6 * louder * rng.standard_normal(record.readings.shape)
    there = Bench(replace(record, readings=record.readings + noise))
    entries = tournament(there, [all_effects()[name] for name in ("loop-delay", "bpm-latency")])
    assert entries[0].kind.id == "loop-delay"
    every = next(one for one in entries if len(one.cause.places) == record.readings.shape[1])
    assert every.worth < entries[0].worth
