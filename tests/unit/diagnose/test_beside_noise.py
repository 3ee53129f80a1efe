"""Causes beside BPMs whose noise is a cause by itself, and noise that is not what it seems."""

from dataclasses import replace

import numpy as np
import pytest
from test_scans import BPMS, CORRECTORS, LAYOUT, RING, record_with

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.deafened import without_bpms
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.noise_departure import noise_laws
from orbitfb.diagnose.noise_modes import NoiseModes
from orbitfb.diagnose.randomness import parted
from orbitfb.diagnose.search import search
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.build import build
from orbitfb.effects.registry import all_effects
from orbitfb.effects.settings import parse_effect

LEVEL, WALK, GAIN = (all_effects()[name] for name in ("noise-level", "bpm-walk", "corrector-gain"))
NOISY, WEAK = BPMS[20], CORRECTORS[90]


def test_a_deaf_bpm_is_a_mode_by_itself_and_has_no_level_of_its_own():
    spread = np.ones(len(BPMS))
    spread[[3, 20]] = 1e3, 2.0
    modes = NoiseModes.of(LAYOUT, spread, deaf=(3,))
    assert np.abs(modes.axes[3, -1]) == pytest.approx(1.0)
    assert np.count_nonzero(np.abs(modes.axes[:, -1]) > 1e-9) == 1
    assert modes.levels[3] == 0.0
    assert modes.levels[20] == pytest.approx(2.0 * np.log(2.0))


def test_what_else_is_wrong_is_found_beside_a_noisy_bpm():
    texts = (f"noise-level:factor=5,names={NOISY}", f"corrector-gain:gain=0.3,names={WEAK}")
    effects = build([parse_effect(text) for text in texts], LAYOUT, 1)
    record = simulate_record(RING, "x", 700, 5, effects, dither=1.5e-3, period=LAYOUT.period)
    found = search(record, [LEVEL, WALK, GAIN])
    causes = [one.accepted.cause for one in found.winners]
    assert [(cause.kind.id, cause.places) for cause in causes] == [
        ("noise-level", (20,)),
        ("corrector-gain", (90,)),
    ]
    assert found.bench.record is record  # with all its BPMs


def test_only_few_bpms_are_left_out_and_those_before_stay_so():
    bench = Bench(record_with(f"noise-level:factor=3,names={NOISY}", dither=0.0, ticks=200))
    most, values = tuple(range(len(BPMS) // 2)), {"factor": 2.0}
    assert without_bpms(bench, Cause(LEVEL, most, values)) is None
    telegraph = Cause(all_effects()["telegraph"], (3,), {"kick": 1e-8, "probability": 0.1})
    assert without_bpms(bench, telegraph) is None
    record, modes = without_bpms(bench, Cause(LEVEL, (20,), values))
    there = Bench(record, (), None, modes)
    _, again = without_bpms(there, Cause(LEVEL, (7,), values))
    assert again.deaf == (7, 20)


@pytest.mark.parametrize(("burst", "said"), [(False, False), (True, True)])
def test_noise_of_a_part_of_the_record_is_not_the_noise_of_its_law(burst, said):
    record = record_with("bpm-gain:gain=0,cells=C01", dither=0.0)
    rng = np.random.default_rng(3)
    readings = record.readings.copy()
    rows = slice(200, 300) if burst else slice(None)
    size = 6e-7 if burst else 3e-7
    readings[rows, 20] += size * rng.standard_normal(len(readings[rows]))
    bench = Bench(replace(record, readings=readings))
    told = dict(noise_laws(bench, Cause(LEVEL, (20,), {"factor": 2.0}), 0.0))
    assert (told["as noise that comes and goes"] > 20.0) is said


def test_heavy_tails_are_no_change_of_the_level():
    rng = np.random.default_rng(3)
    squares = rng.standard_normal((1500, 4)) ** 2
    squares[1000:, 0] *= 2.0
    squares[:, 1] = rng.standard_t(2.5, 1500) ** 2
    rows, gain, before, after = parted(squares)
    assert abs(rows[0] - 1000) < 100
    assert gain[0] > 20.0
    assert after[0] / before[0] == pytest.approx(2.0, abs=0.3)
    assert np.all(gain[1:] < np.log(1500))


def test_the_change_of_several_adds_up():
    squares = np.random.default_rng(4).standard_normal((1500, 5)) ** 2
    squares[1000:] *= 1.5
    each = parted(squares)[1]
    together = parted(squares.mean(axis=1, keepdims=True), 5.0)[1]
    assert together[0] == pytest.approx(np.sum(each), rel=0.2)
