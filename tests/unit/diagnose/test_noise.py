"""Noise that all BPMs have, each in its own measure."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.engine import diagnose
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.noise_colour import colour_of_all
from orbitfb.diagnose.random_values import state
from orbitfb.diagnose.scan import Scanner
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.diagnose.tournament import tournament
from orbitfb.effects.build import build, layout_of
from orbitfb.effects.registry import all_effects
from orbitfb.effects.settings import parse_effect
from orbitfb.physics.places import Ring

RING = Ring.load()
LAYOUT = layout_of(RING, "x", 0.1)
BPMS = LAYOUT.bpms.names
TICKS = 900


def unequal(*effects: str, dither: float = 1e-3):
    """A record of three types of BPMs, one three times as noisy as another, crate by crate."""
    noisy = [
        parse_effect(f"noise-level:factor={factor},cells={'+'.join(cells)}")
        for factor, cells in (
            (1.73, [f"C{cell:02d}" for cell in range(1, 31, 3)]),
            (3.0, [f"C{cell:02d}" for cell in range(2, 31, 3)]),
        )
    ]
    own = build([*noisy, *map(parse_effect, effects)], LAYOUT, 1)
    return simulate_record(RING, "x", TICKS, 5, own, dither=dither, period=LAYOUT.period)


def test_the_floor_knows_how_noisy_each_bpm_is():
    spread = Bench(unequal()).floor.modes.spread
    types = np.array([1.0, 1.73, 3.0])
    cell = np.array([int(name.split("_C")[1]) % 3 for name in BPMS])
    true = types[np.choose(cell, [0, 1, 2])]
    off = np.log(spread / true)
    # The median of 900 squares tells a noise to 4 %.
    assert np.std(off) < 0.06
    assert np.ptp(off) < 0.4


def test_bpms_that_are_alike_stay_alike():
    record = simulate_record(RING, "x", TICKS, 5, [], dither=1e-3, period=LAYOUT.period)
    modes = Bench(record).floor.modes
    assert np.all(modes.spread == 1.0)
    assert modes.scatter == 0.0


def test_bpms_of_unequal_noise_are_no_gap():
    answer = diagnose(unequal(), None, None, seed=0, progress=lambda what, share: None)
    assert answer.state == "no_gap"


def test_a_gain_is_found_among_bpms_of_unequal_noise():
    kinds = [all_effects()[name] for name in ("bpm-gain", "bpm-lowpass", "noise-level")]
    best, *_ = tournament(Bench(unequal(f"bpm-gain:gain=0.3,names={BPMS[20]}")), kinds)
    assert best.kind.id == "bpm-gain"
    assert best.cause.places == (20,)
    assert best.cause.values["gain"] == pytest.approx(0.3, abs=0.1)


@pytest.mark.parametrize("correlation", [0.2, 0.0])
def test_a_colour_of_all_bpms_is_seen(correlation: float):
    effects = build([parse_effect(f"noise-coloured:correlation={correlation}")], LAYOUT, 1)
    record = simulate_record(RING, "x", TICKS, 5, effects, dither=0.0, period=LAYOUT.period)
    found = colour_of_all(Bench(record), all_effects()["noise-coloured"])
    if correlation:
        assert found is not None
        assert found.gain > 20.0
        assert found.cause.values["correlation"] == pytest.approx(correlation, rel=0.1)
    else:
        assert found is None or found.gain < 3.0


@pytest.mark.parametrize("correlation", [-0.3, 0.2])
def test_the_interval_of_a_colour_of_all_holds_it(correlation: float):
    record = simulate_record(RING, "x", TICKS, 5, [], dither=0.0, period=LAYOUT.period)
    places = tuple(range(len(BPMS)))
    cause = Cause(all_effects()["noise-coloured"], places, {"correlation": correlation})
    low, high = state(Bench(record), cause).intervals["correlation"]
    assert low < correlation < high


def test_currents_that_stand_still_hide_no_leak():
    """Half of the correctors and more never move: no share of nothing decides who leaks."""
    first, second, share = 112, 110, 0.2
    record = simulate_record(RING, "x", 500, 5, [], dither=0.0, period=LAYOUT.period)
    steady = record.setpoints[:1] + 0.0 * record.setpoints
    course = np.repeat(0.01 * np.random.default_rng(3).standard_normal(11), 50)[: len(record)]
    setpoints = steady.copy()
    setpoints[:, first] += course
    kept = record.readings - (record.setpoints - steady) @ LAYOUT.response.T
    made = LAYOUT.response[:, first] + share * LAYOUT.response[:, second]
    steered = replace(record, setpoints=setpoints, readings=kept + np.outer(course, made))
    kind = all_effects()["corrector-crosstalk"]
    pairs = kind.pairs(LAYOUT)
    found = Scanner(Bench(steered, background=0.0)).candidates(kind)[0]
    assert tuple(pairs[found.cause.places[0]]) == (first, second)
    assert found.cause.values["share"] == pytest.approx(share, rel=0.1)
    beside = [one.cause for one in Scanner(Bench(steered)).candidates(kind)]
    assert {pairs[cause.places[0]][0] for cause in beside if not cause.onset} <= {first}


@pytest.mark.parametrize("place", [20, 77, 140])
def test_a_bpm_that_is_loud_all_the_time_is_compared_with_the_healthy_ones(place: int):
    scatter, factor = 0.1, 1.7
    levels = np.exp(scatter * np.random.default_rng(place).standard_normal(len(BPMS)))
    levels[place] *= factor
    texts = [
        f"noise-level:factor={level:.4f},names={name}"
        for level, name in zip(levels, BPMS, strict=True)
    ]
    effects = build([parse_effect(text) for text in texts], LAYOUT, 1)
    record = simulate_record(RING, "x", TICKS, 5, effects, dither=0.0, period=LAYOUT.period)
    kind = all_effects()["noise-level"]
    found = state(Bench(record), Cause(kind, (place,), {"factor": 1.3}))
    # What it has without the effect scatters by a tenth, 0.16 at 90 %.
    assert found.cause.values["factor"] == pytest.approx(factor, rel=0.25)
    low, high = found.intervals["factor"]
    assert low < factor < high
    assert 1.25 < high / low < 1.6
