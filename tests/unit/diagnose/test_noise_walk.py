"""What walks, and noise that is not the noise of its law."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.noise_departure import _of_steps, noise_laws
from orbitfb.diagnose.noise_walk import walking_candidates
from orbitfb.diagnose.random_values import state
from orbitfb.diagnose.randomness import noise_candidates
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.build import build, layout_of
from orbitfb.effects.registry import all_effects
from orbitfb.effects.settings import parse_effect
from orbitfb.physics.places import Ring

RING = Ring.load()
LAYOUT = layout_of(RING, "x", 0.1)
BPMS = LAYOUT.bpms.names


def record_with(*effects: str, ticks: int = 900):
    made = build([parse_effect(effect) for effect in effects], LAYOUT, 1)
    return simulate_record(RING, "x", ticks, 5, made, period=LAYOUT.period)


def test_a_crate_that_walks_far_below_its_noise_is_found():
    record = record_with("bpm-walk:step=15nm,cells=C14")
    bench, kind = Bench(record), all_effects()["bpm-walk"]
    assert bench.floor.reading**0.5 > 10 * 15e-9
    found = walking_candidates(bench, kind)[0]
    assert found.group.startswith("C14")
    assert found.gain > 50.0
    low, high = state(bench, found.cause).intervals["step"]
    assert low < 15e-9 < high


def test_a_crate_may_become_noisier_in_the_middle_of_a_record():
    record = record_with("noise-level:factor=1.2,cells=C14,from=65s")
    found = noise_candidates(Bench(record), all_effects()["noise-level"])[0]
    assert found.group == "C14"
    assert abs(found.cause.onset - 450) < 30  # the record begins after 20 s
    assert found.cause.values["factor"] == pytest.approx(1.2, abs=0.05)
    quiet = noise_candidates(Bench(record_with()), all_effects()["noise-level"])
    assert all(one.gain - np.log(one.choices) < 3.0 for one in quiet)


def test_nothing_walks_in_a_quiet_record():
    bench = Bench(record_with())
    for name in ("bpm-walk", "energy-drift"):
        assert all(one.gain < 9.0 for one in walking_candidates(bench, all_effects()[name]))


@pytest.mark.parametrize("size", [0.0, 0.3e-6])
def test_an_offset_that_alternates_is_no_noise(size):
    record, place = record_with(f"noise-level:factor=1.5,names={BPMS[40]}"), 40
    readings = record.readings.copy()
    readings[:, place] += size * (-1.0) ** np.arange(len(readings))
    bench, kind = Bench(replace(record, readings=readings)), all_effects()["noise-level"]
    cause = state(bench, Cause(kind, (place,), {"factor": 1.5})).cause
    laws = dict(noise_laws(bench, cause, 0.0))
    alternating = laws["as an offset that alternates from tick to tick"]
    assert (alternating > 30.0) is (size > 0.0)
    if not size:
        assert max(laws.values()) < 5.0


def test_noise_with_a_longer_memory_is_no_noise_of_the_law():
    record, place = record_with(), 40
    rng = np.random.default_rng(2)
    ring = np.zeros(len(record) + 2)
    for row in range(2, len(ring)):
        ring[row] = ring[row - 1] - 0.7 * ring[row - 2] + 0.3e-6 * rng.standard_normal()
    readings = record.readings.copy()
    readings[:, place] += ring[2:]
    bench, kind = Bench(replace(record, readings=readings)), all_effects()["noise-coloured"]
    cause = state(bench, Cause(kind, (place,), {"correlation": 0.3})).cause
    assert max(nats for _, nats in noise_laws(bench, cause, 0.0)) > 30.0


@pytest.mark.parametrize("switched", [True, False])
def test_an_offset_that_another_channel_switches_is_no_walk(switched):
    told = () if switched else (f"bpm-walk:step=0.2um,names={BPMS[40]}",)
    record, place = record_with(*told), 40
    current = 0.4 + 0.004 * np.sin(np.arange(len(record)) / 40.0)
    readings = record.readings.copy()
    if switched:
        readings[:, place] += np.select([current > 0.402, current > 0.399], [2e-6, -1e-6])
    record = replace(record, readings=readings, auxiliary={"current": current})
    bench = Bench(record)
    cause, gain = next(
        (one.cause, one.gain)
        for one in walking_candidates(bench, all_effects()["bpm-walk"])
        if one.cause.places == (place,)
    )
    laws = noise_laws(bench, cause, gain)
    offsets = [nats for course, nats in laws if "go with current" in course]
    assert gain > 30.0
    assert (max(offsets) > 30.0) is switched


def test_the_score_of_offsets_is_that_of_what_they_make():
    record = record_with()
    bench = Bench(record)
    steps = [np.arange(len(record)) % 70 < 30, np.arange(len(record)) % 90 > 60]
    patterns = np.eye(len(BPMS))[:, [7, 40, 41]]
    pull, known = _of_steps(bench, steps, patterns)
    seen = np.array(
        [
            bench.floor.whiten(np.outer(step, shape), record.starts).ravel()
            for step in steps
            for shape in patterns.T
        ]
    )
    np.testing.assert_allclose(pull, seen @ bench.white.ravel(), rtol=1e-9)
    np.testing.assert_allclose(known, seen @ seen.T, rtol=1e-9, atol=1e-9 * known.max())
