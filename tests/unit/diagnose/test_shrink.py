"""A right cause takes the gap away on later data, a wrong one makes it larger."""

from dataclasses import replace

import numpy as np
import pytest
from gap_cases import GAIN, PLACE, bench, gain_error, record

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.competitor import refitted_response
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.judgement import too_little
from orbitfb.diagnose.replay import Replay
from orbitfb.diagnose.shrink import contrast, k_steps, put_aside, shrink
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.build import build, layout_of
from orbitfb.effects.registry import effect
from orbitfb.effects.settings import parse_effect
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import PlantSettings

TRUE = ((PLACE, GAIN),)


@pytest.fixture(scope="module")
def right():
    return contrast(bench(True, TRUE), record(True, seed=6))


@pytest.fixture(scope="module")
def wrong():
    return contrast(bench(True, ((60, 0.3),)), record(True, seed=6))


def test_the_true_cause_shrinks_the_gap(right):
    its = shrink(right)
    assert its.resolved
    assert its.nats > 0.9
    assert its.um > 0.9
    assert its.low <= its.nats <= its.high
    assert its.um_low <= its.um <= its.um_high
    assert its.held_out_ticks == 400
    assert its.before_nats_per_tick > its.after_nats_per_tick


def test_a_wrong_cause_is_negative(wrong):
    its = shrink(wrong)
    assert its.nats < -0.3
    assert its.um < -0.1
    assert its.high < 0.0


def test_a_rival_that_is_right_shows_a_stand_in():
    neighbour = bench(True, ((PLACE + 1, GAIN / 2),))
    alone = shrink(contrast(neighbour, record(True, seed=6)))
    its = shrink(contrast(neighbour, record(True, seed=6), rivals=[gain_error()]))
    assert its.resolved
    assert its.before_um > 1.5 * (alone.before_um or 0.0)
    assert its.um < 0.5


def test_half_the_size_is_half_the_micrometres():
    its = shrink(contrast(bench(True, ((PLACE, GAIN / 2),)), record(True, seed=6)))
    assert its.um == pytest.approx(0.5, abs=0.12)
    assert its.nats == pytest.approx(0.75, abs=0.12)


def test_without_a_gap_nothing_is_resolved():
    its = shrink(contrast(bench(False), record(False, seed=6)))
    assert not its.resolved
    assert its.nats is None or its.nats == 0.0


def test_a_cause_where_there_is_none_is_not_praised():
    its = shrink(contrast(bench(False, TRUE), record(False, seed=6)))
    assert its.nats is None or its.nats < 0.0


def test_a_reversed_bpm_that_moves_little_is_right_all_the_same():
    """Its noise is reversed too, and is most of what it reads: a prediction has nothing of it."""
    centred = PlantSettings(initial_orbit_rms=0.0)

    def quiet(seed):
        made = simulate_record(
            Ring.load(), "x", 700, seed, dither=1e-5, steering=0, plant=centred, period=0.1
        )
        made.readings[:, 30] *= -1.0
        return made

    reversed_bpm = Cause(effect("bpm-polarity"), (30,), {})
    its = shrink(contrast(Bench(quiet(3), (reversed_bpm,)), quiet(4)))
    assert its.resolved
    assert its.um == pytest.approx(1.0, abs=0.15)


def test_the_cause_beats_the_fit(right):
    its = shrink(right)
    assert its.competitor_um < its.um
    assert its.competitor_nats < its.nats


def test_the_excess_grows_with_the_steps_and_goes_with_the_cause(right):
    steps = k_steps(right)
    assert [step.k for step in steps] == [1, 2, 5, 10, 50]
    nominal = [step.nominal_um for step in steps]
    assert nominal[-1] > nominal[0] > 0.0
    assert all(step.effect_um < 0.25 * step.nominal_um for step in steps)
    assert all(step.nominal_low <= step.nominal_um <= step.nominal_high for step in steps)


def test_a_refit_learns_nothing_where_there_is_nothing():
    quiet = np.abs(refitted_response(Replay.of(bench(False))))
    assert quiet.max() < 0.02 * np.abs(record(False).layout.response).max()


def test_the_last_fifth_is_put_aside():
    whole = record(False, ticks=600)
    fitted, later = put_aside(whole)
    assert later is not None
    assert len(fitted) + len(later) == len(whole)
    assert len(later) == round(len(whole) / 5)
    assert later.starts[0]
    assert later.time[0] > fitted.time[-1]


def test_an_end_put_aside_serves_as_a_later_record():
    fitted, later = put_aside(record(True, ticks=600))
    assert later is not None
    its = shrink(contrast(Bench(fitted, [gain_error()]), later), "the end of the record")
    assert its.nats > 0.9
    assert its.held_out_ticks == len(later) - 1


def test_nothing_is_put_aside_of_a_short_record():
    short = record(False)
    assert put_aside(short) == (short, None)


@pytest.mark.parametrize("clock", ["one", "another", "one after it stopped"])
def test_a_drift_goes_on_in_a_later_record_or_has_stopped(clock):
    ring = Ring.load()
    layout = layout_of(ring, "x", 0.1)
    drift = parse_effect("tune-drift:rate_x=0.0003")
    effects = build([drift], layout, 1)
    whole = simulate_record(ring, "x", 900, 5, effects, dither=2e-3, period=layout.period)
    first, later = whole.rows(0, 450), whole.rows(450, 900)
    begun = {"one": float(later.time[0]), "another": 0.0, "one after it stopped": 3600.0}[clock]
    later = replace(later, time=later.time - later.time[0], began=begun)
    cause = Cause(effect("tune-drift"), (), {"rate_x": 0.0003, "rate_y": 0.0})
    its = shrink(contrast(Bench(first, (cause,)), later))
    assert its.resolved
    assert its.nats > 0.9


@pytest.mark.parametrize(("error", "healthy"), [(0.02, True), (0.3, False)])
def test_what_healthy_errors_may_do_in_a_later_record_speaks_against_no_cause(error, healthy):
    """A corrector that the first record hardly moves is moved far in the later one."""
    ring, other = Ring.load(), 60
    layout = layout_of(ring, "x", 0.1)
    model = layout.response.copy()
    model[:, other] /= 1.0 + error
    effects = build(
        [parse_effect(f"corrector-gain:gain=0.3,names={layout.correctors.names[PLACE]}")], layout, 1
    )
    far = np.zeros((500, len(layout.correctors)))
    far[:, other] = 0.1 * np.repeat(np.random.default_rng(1).standard_normal(50), 10)
    first, later = (
        simulate_record(
            ring, "x", 500, seed, effects, dither=dither, response=model, excitation=moved
        )
        for seed, dither, moved in ((5, 1e-4, None), (6, 0.0, far))
    )
    bench, rival = Bench(first, [gain_error()]), gain_error(other, error)
    plain, beyond = (
        shrink(contrast(bench, later, rivals=[rival], beyond_healthy=open_)) for open_ in (0, 1)
    )
    assert too_little(plain)
    assert plain.after_nats_per_tick * 500 > 500.0
    assert (beyond.after_nats_per_tick * 500 < 10.0) is healthy


def test_errors_of_an_unknown_ring_are_the_same_in_a_later_record_of_another_excitation():
    """Which orbits are wrong by themselves is chosen by what the first record steers."""
    first, later = (
        replace(one, layout=replace(one.layout, ring=None))
        for one in (record(True), record(True, seed=6, dither=2e-4))
    )
    fitted = Bench(first, [gain_error()])
    there = fitted.background.elsewhere(fitted.currents, fitted.orbit, first.starts)
    sizes = np.random.default_rng(2).standard_normal(len(fitted.sizes))
    np.testing.assert_array_equal(there.orbit(sizes), fitted.background.orbit(sizes))
    assert len(Bench(later, [gain_error()]).sizes) != len(fitted.sizes)
    its = shrink(contrast(fitted, later))
    assert its.resolved
    assert its.nats > 0.9


@pytest.mark.parametrize(("row", "cut"), [(610, 610), (639, 639), (645, 640), (300, 640)])
def test_what_begins_just_before_the_cut_is_put_aside_whole(row, cut):
    its = record(False, ticks=799, seed=6)
    readings = its.readings.copy()
    readings[row:, 30] *= -1.0
    readings[row:, 31] += 30e-6
    first, later = put_aside(replace(its, readings=readings))
    assert len(first) == cut
    assert len(later) == len(its) - cut
