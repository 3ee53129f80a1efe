"""What a scan of places must not step over."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.diagnose.bench import Bench, log_likelihood
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fit import fit
from orbitfb.diagnose.random_values import state
from orbitfb.diagnose.randomness import noise_candidates
from orbitfb.diagnose.scan import Scanner
from orbitfb.diagnose.scan_shapes import Scoring
from orbitfb.diagnose.search import search
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.diagnose.strike_scan import latent_candidates
from orbitfb.diagnose.tournament import tournament
from orbitfb.effects.actuating import usual_change
from orbitfb.effects.build import build, layout_of
from orbitfb.effects.registry import all_effects
from orbitfb.effects.settings import parse_effect
from orbitfb.physics.places import Ring

RING = Ring.load()
LAYOUT = layout_of(RING, "x", 0.1)
BPMS, CORRECTORS = LAYOUT.bpms.names, LAYOUT.correctors.names


def record_with(effect: str, *, dither: float, ticks: int = 700):
    effects = build([parse_effect(effect)], LAYOUT, 1)
    return simulate_record(RING, "x", ticks, 5, effects, dither=dither, period=LAYOUT.period)


def best(record, kind: str):
    return Scanner(Bench(record)).candidates(all_effects()[kind])[0]


def test_an_averaging_bpm_shows_in_a_record_that_nobody_shook():
    record = record_with(f"bpm-lowpass:tau=0.1s,names={BPMS[20]}", dither=0.0)
    found = best(record, "bpm-lowpass")
    assert found.cause.places == (20,)
    assert found.gain > 50.0


def test_steps_that_are_small_beside_the_dither_are_found():
    cells = "cells=C09"
    record = record_with(f"corrector-quantisation:step=0.4mA,{cells}", dither=3e-3)
    assert 0.3 * usual_change(record) > 0.4e-3
    found = best(record, "corrector-quantisation")
    assert {CORRECTORS[place] for place in found.cause.places} == {
        name for name in CORRECTORS if name.endswith("C09")
    }
    assert abs(found.cause.values["step"] / 0.4e-3 - 1.0) < 1e-3


def test_a_kick_that_grows_from_the_middle_on_and_settles_is_found():
    place = "QL2A_C17"
    rise = f"thermal-drift:rate=2e-8rad/s,tau=10s,names={place},from=50s"
    record = record_with(rise, dither=0.0)
    kind = all_effects()["thermal-drift"]
    found = best(record, kind.id)
    names = kind.places_of(record.layout)
    assert names[found.cause.places[0]].startswith(place)
    assert abs(found.cause.onset - 300) < 40
    fitted = fit(Bench(record), (found.cause,))
    ramp = Scanner(Bench(record)).candidates(all_effects()["insertion-device"])[0]
    assert fitted.gain > fit(Bench(record), (ramp.cause,)).gain + 5.0
    assert fitted.interval(1)[0] < 10.0 < fitted.interval(1)[1]


def test_how_long_a_ramp_takes_is_not_sought_where_no_ramp_is_worth_anything():
    record = record_with(f"bpm-gain:gain=0.01,names={BPMS[20]}", dither=0.0, ticks=400)
    values = {"kick": 5e-7, "period": 0.03, "duration": 3.0}
    cause = Cause(all_effects()["insertion-device"], (100,), values, 200)
    bench = Bench(record)
    left, sought = fit(bench, (cause,), least=20.0), fit(bench, (cause,))
    assert left.causes[0].values["duration"] == pytest.approx(3.0)
    assert sought.causes[0].values["duration"] != pytest.approx(3.0)
    assert left.causes[0].values["kick"] != 5e-7 and sought.gain < 20.0


# The record begins after 20 s, so that 50 s is row 300.
def test_crosstalk_that_begins_in_the_middle_is_not_a_kick():
    first, second = 33, 32
    names = f"names={CORRECTORS[first]}+{CORRECTORS[second]}"
    record = record_with(f"corrector-crosstalk:share=0.3,{names},from=50s", dither=3e-3)
    kind = all_effects()["corrector-crosstalk"]
    found = best(record, "corrector-crosstalk")
    assert tuple(kind.pairs(record.layout)[found.cause.places[0]]) == (first, second)
    assert abs(found.cause.onset - 300) < 3


def test_a_small_leak_that_begins_where_the_current_is_zero_makes_no_jump_and_is_found():
    first, second, dither = 33, 32, 3e-3
    still = record_with(f"corrector-gain:gain=0,names={CORRECTORS[first]}", dither=dither)
    row = 290 + int(np.argmin(np.abs(still.setpoints[290:330, first])))
    names = f"names={CORRECTORS[first]}+{CORRECTORS[second]}"
    leak = f"corrector-crosstalk:share=0.015,{names},from={20.0 + 0.1 * row:.1f}s"
    record = record_with(leak, dither=dither)
    kind = all_effects()["corrector-crosstalk"]
    found = best(record, "corrector-crosstalk")
    assert tuple(kind.pairs(record.layout)[found.cause.places[0]]) == (first, second)
    assert abs(found.cause.onset - row) < 8


def test_a_corrector_that_is_turned_in_the_middle_is_found_where_it_begins():
    layout = layout_of(RING, "xy", 0.1)
    kind = all_effects()["corrector-roll"]
    pair = 40
    names = layout.correctors.names
    turned = names[int(kind.pairs(layout)[pair][0])]
    effects = build([parse_effect(f"corrector-roll:angle=0.02,names={turned},from=35s")], layout, 1)
    record = simulate_record(RING, "xy", 300, 5, effects, dither=2e-3, period=0.1)
    found = best(record, kind.id)
    assert {names[int(column)] for column in kind.pairs(layout)[found.cause.places[0]]} == {turned}
    assert abs(found.cause.onset - 150) < 5  # the record begins at 20 s
    assert found.cause.values["angle"] == pytest.approx(0.02, rel=0.2)


def test_a_slow_drift_of_the_tune_is_scanned_at_its_rate_and_not_as_many_free_kicks():
    """Between the rates of a grid; all correctors with free first kicks would pay for each."""
    record = record_with("tune-drift:rate_x=3e-5", dither=3e-3)
    found = best(record, "tune-drift")
    assert found.gain > 100.0
    assert found.cause.values["rate_x"] == pytest.approx(3e-5, rel=0.2)
    for other in Scanner(Bench(record)).candidates(all_effects()["corrector-gain"]):
        assert not (other.cause.free and len(other.cause.places) > 60)


@pytest.mark.parametrize(
    ("size", "where", "places", "dither"),
    [
        ("bpm-nonlinearity:quadratic=60,cubic=0", f",names={BPMS[20]}", (20,), 5e-3),
        ("bpm-lowpass:tau=16ms", "", tuple(range(len(BPMS))), 8e-3),
        ("corrector-lag:tau=16ms", "", tuple(range(len(CORRECTORS))), 8e-3),
        ("corrector-resonance:frequency=9Hz,damping=0.9", "", tuple(range(len(CORRECTORS))), 8e-3),
        ("corrector-quantisation:step=0.07mA", f",names={CORRECTORS[60]}", (60,), 3e-3),
        ("loop-delay:ticks=0.01", "", (), 3e-3),
    ],
)
def test_what_is_small_and_shows_is_not_stepped_over(size, where, places, dither):
    """However fine a grid is, a record that is shaken hard shows less than its least value."""
    record = record_with(size + where, dither=dither)
    effect, bench = parse_effect(size), Bench(record)
    true = Cause(effect.kind, places, effect.filled)
    there = log_likelihood(*bench.residual((true,))) - bench.log_likelihood
    found = Scanner(bench).candidates(effect.kind)[0]
    assert set(found.cause.places) == set(places)
    assert found.gain > 0.4 * there > 10.0


@pytest.mark.parametrize("begins", [0, 300])
@pytest.mark.parametrize("name", ["bpm-polarity", "bpm-swap"])
def test_readings_that_are_turned_show_while_magnets_steer_against_the_ground(name, begins):
    """What the magnets do is far from what the beam does: it is the readings that tell."""
    healthy = record_with(f"bpm-gain:gain=0.001,names={BPMS[90]}", dither=1e-3)
    readings, columns = healthy.readings.copy(), [20, 22] if name == "bpm-swap" else [34]
    turned = readings[begins:, columns[::-1]] if name == "bpm-swap" else -readings[begins:, columns]
    readings[begins:, columns] = turned  # of BPMs that the feedback does not use
    steering = 0.05 * np.random.default_rng(3).standard_normal(len(CORRECTORS))
    seen = replace(healthy, readings=readings, setpoints=healthy.setpoints + steering)
    # as the tournament looks for what has no size, beside no healthy errors
    bench, kind = Bench(seen, background=0.0), all_effects()[name]
    found = Scanner(bench).candidates(kind)[0]
    (place,) = found.cause.places
    assert [place] == columns or tuple(columns) == kind.struck(seen.layout, place)
    assert abs(found.cause.onset - begins) < 40
    exact = log_likelihood(*bench.residual((found.cause,))) - bench.log_likelihood
    assert exact > 20.0
    assert abs(found.gain / exact - 1.0) < 0.2


def test_an_exchange_that_begins_in_the_middle_costs_the_jump_of_a_steered_orbit():
    """With magnets that steer by 100 µm an exchange would jump by as much: it promises nothing."""
    record = record_with(f"corrector-gain:gain=0.3,names={CORRECTORS[20]}", dither=0.0, ticks=400)
    steering = 0.05 * np.random.default_rng(3).standard_normal(len(CORRECTORS))
    steered = replace(record, setpoints=record.setpoints + steering)
    scanner = Scanner(Bench(steered))
    promised = [
        found.gain
        for kind in ("bpm-swap", "corrector-swap")
        for found in scanner.candidates(all_effects()[kind])
    ]
    assert max(promised, default=0.0) < 50.0


def test_a_roll_that_begins_in_the_middle_is_not_an_offset():
    layout = layout_of(RING, "xy", 0.1)
    roll = parse_effect(f"bpm-roll:angle=0.05,names={BPMS[20]},from=50s")
    effects = build([roll], layout, 1)
    record = simulate_record(RING, "xy", 500, 5, effects, dither=2e-3, period=layout.period)
    bench, kind = Bench(record), all_effects()["bpm-roll"]
    found = Scanner(bench).candidates(kind)[0]
    offset = Scanner(bench).candidates(all_effects()["bpm-offset"])[0]
    assert record.layout.bpms.names[kind.pairs(record.layout)[found.cause.places[0]][0]] == BPMS[20]
    assert abs(found.cause.onset - 300) < 16  # the tournament finds the very row
    assert abs(found.cause.values["angle"] / 0.05 - 1.0) < 0.3
    assert found.gain > offset.gain + 10.0


def test_the_predicted_orbit_knows_nothing_of_the_noise_of_its_row():
    """With a wrong gain in the model the innovation is that of the restored reading."""
    record = record_with(f"bpm-gain:gain=0.5,names={BPMS[20]}", dither=2e-3)
    cause = Cause(all_effects()["bpm-gain"], (20,), {"gain": 0.5})
    bench = Bench(record, (cause,))
    noise = record.readings[:, 20] / 1.5 - bench.orbit[:, 20]
    course = bench.orbit[:, 20] - bench.orbit[:, 20].mean()
    assert abs(np.corrcoef(noise[1:], course[1:])[0, 1]) < 0.12


def test_a_little_colour_of_a_whole_cell_is_seen():
    record = record_with("noise-coloured:correlation=0.15,cells=C09", dither=0.0, ticks=900)
    found = noise_candidates(Bench(record), all_effects()["noise-coloured"])[0]
    assert {BPMS[place] for place in found.cause.places} == {n for n in BPMS if n.endswith("C09")}
    assert found.gain > 25.0


@pytest.mark.parametrize("effect", ["bpm-gain:gain=0.3", "noise-level:factor=1.3"])
def test_a_louder_reading_is_a_gain_only_if_the_orbit_is_louder_too(effect):
    record = record_with(f"{effect},names={BPMS[20]}", dither=5e-4)
    kinds = [all_effects()[name] for name in ("bpm-gain", "noise-level")]
    best, *others = tournament(Bench(record), kinds)
    assert best.kind.id == effect.split(":")[0]
    assert best.cause.places == (20,)
    if best.kind.id == "bpm-gain":
        assert best.fit.inflation < 1.2
    else:
        assert any(one.kind.id == "bpm-gain" and one.cause.places == (20,) for one in others)


@pytest.mark.parametrize(("step", "seen"), [(2e-8, True), (0.0, False)])
def test_an_energy_that_wanders_is_not_taken_for_ground_motion(step, seen):
    """The floor's own levels of the few modes of the dispersion would explain it, if let."""
    effects = build([parse_effect(f"energy-drift:step={step}")], LAYOUT, 1) if step else []
    record = simulate_record(RING, "x", 700, 5, effects, dither=2e-3, period=LAYOUT.period)
    bench, kind = Bench(record), all_effects()["energy-drift"]
    gains = [one.gain for one in noise_candidates(bench, kind)]
    assert (max(gains, default=0.0) > 10.0) is seen
    if seen:
        told = state(bench, noise_candidates(bench, kind)[0].cause)
        low, high = told.intervals["step"]
        assert low < step < high < 2.0 * low


def test_a_doubled_noise_is_worth_its_likelihood():
    """A gain of 1 doubles the noise too: N (ρ − 1 − log ρ) / 2 has to decide, not ¼ N log² ρ."""
    record = record_with(f"noise-level:factor=2,names={BPMS[20]}", dither=0.0)
    found = noise_candidates(Bench(record), all_effects()["noise-level"])[0]
    assert found.cause.places == (20,)
    assert found.alone is not None
    ratio = found.cause.values["factor"] ** 2
    assert found.alone == pytest.approx(700 * (ratio - 1 - np.log(ratio)) / 2, rel=0.1)


def test_a_dead_zone_is_found_however_far_the_orbit_was_steered_away():
    """Its width alone shows, and one large step at the beginning says nothing of the others."""
    record = record_with("corrector-deadband:width=0.05mA", dither=1e-3)
    setpoints = record.setpoints.copy()
    jump = 0.2 * np.sin(np.arange(len(CORRECTORS)))
    setpoints[20:] += jump
    readings = record.readings.copy()
    readings[20:] += LAYOUT.response @ jump
    found = best(replace(record, setpoints=setpoints, readings=readings), "corrector-deadband")
    assert len(found.cause.places) == len(CORRECTORS)
    assert found.cause.values["width"] == pytest.approx(0.05e-3, rel=0.25)


def test_noise_of_a_few_bpms_here_and_there_is_one_cause():
    struck = (5, 40, 77, 90, 133, 170)
    names = "+".join(BPMS[place] for place in struck)
    record = record_with(f"noise-level:factor=2,names={names}", dither=0.0)
    found = noise_candidates(Bench(record), all_effects()["noise-level"])[0]
    assert found.cause.places == struck
    assert found.cause.values["factor"] == pytest.approx(2.0, rel=0.1)


def test_noise_of_a_cell_that_rises_in_the_middle_is_told_from_then_on():
    """Its mean over the record is no factor that the BPMs ever had."""
    record = record_with("noise-level:factor=2,cells=C09,from=50s", dither=0.0)
    bench = Bench(record)
    found, *_ = tournament(bench, [all_effects()["noise-level"]])
    assert {BPMS[place] for place in found.cause.places} == {n for n in BPMS if n.endswith("C09")}
    assert abs(found.cause.onset - 300) < 6
    told = state(bench, found.cause)
    low, high = told.intervals["factor"]
    assert low < 2.0 < high < 1.15 * low


def test_a_bpm_that_was_always_noisy_is_no_reason_for_a_larger_factor():
    """What begins in the middle is measured by what the same BPM had before."""
    names = f"names={BPMS[20]}"
    effects = build(
        [
            parse_effect(f"noise-level:factor=1.5,{names}"),
            parse_effect(f"noise-level:factor=2,{names},from=50s"),
        ],
        LAYOUT,
        1,
    )
    record = simulate_record(RING, "x", 1500, 5, effects, dither=0.0, period=LAYOUT.period)
    bench = Bench(record)
    cause = Cause(all_effects()["noise-level"], (20,), {"factor": 3.0}, 300)
    low, high = state(bench, cause).intervals["factor"]
    assert low < 2.0 < high < 1.3 * low


def test_a_leak_is_told_by_what_healthy_optics_leave_of_it():
    """What a corrector that is steered far does to the whole orbit, wrong gradients do in part."""
    first, second, share = 112, 110, 0.2
    record = record_with("bpm-gain:gain=0", dither=0.0)
    levels = 0.01 * np.random.default_rng(3).standard_normal(len(record) // 50 + 1)
    course = np.repeat(levels, 50)[: len(record)]
    setpoints = record.setpoints.copy()
    setpoints[:, first] += course
    made = LAYOUT.response[:, first] + share * LAYOUT.response[:, second]
    steered = replace(
        record, setpoints=setpoints, readings=record.readings + np.outer(course, made)
    )
    found = best(steered, "corrector-crosstalk")
    kind = all_effects()["corrector-crosstalk"]
    assert tuple(kind.pairs(record.layout)[found.cause.places[0]]) == (first, second)
    assert found.cause.values["share"] == pytest.approx(share, rel=0.2)


@pytest.mark.parametrize("cell", ["C05", "C25"])
def test_neighbours_that_steer_against_each_other_are_seen_together(cell):
    record = record_with("bpm-gain:gain=0", dither=1e-3)
    bench, kind = Bench(record, background=0.0), all_effects()["corrector-lag"]
    scoring = Scoring(bench)
    changes = scoring.changes(kind, {"tau": 0.1})
    own = np.flatnonzero([name.endswith(cell) for name in CORRECTORS])
    (shapes, _), *_ = changes.parts
    against = np.linalg.svd(shapes.patterns[:, own])[2][-1]
    drivers = np.zeros(record.setpoints.shape)
    drivers[:, own] = np.outer(np.random.default_rng(1).standard_normal(len(record)), against)
    changes = replace(changes, parts=((shapes, 1e-3 * drivers),))
    seen = bench.energy(1e-3 * drivers @ shapes.patterns.T)
    assert scoring.together(changes, [own])[0] == pytest.approx(seen, rel=0.2)
    assert changes.information[0][own].sum() > 5.0 * seen


def test_what_a_crate_has_in_common_is_no_level_of_a_single_bpm():
    """Healthy levels differ by 5 % BPM by BPM, so that the sum of six differs by 2 %."""
    record = record_with("noise-correlated:rms=0.06um,cells=C09", dither=0.0, ticks=1200)
    found = noise_candidates(Bench(record), all_effects()["noise-correlated"])[0]
    (place,) = found.cause.places
    assert all_effects()["noise-correlated"].places_of(LAYOUT)[place] == "C09 (x)"
    assert found.gain > 35.0


def test_tails_of_a_crate_that_are_twice_the_noise_have_their_size():
    size = 0.4e-6
    effect = f"noise-tails:probability=0.04,amplitude={size}m,cells=C09"
    bench = Bench(record_with(effect, dither=0.0, ticks=1200))
    found = latent_candidates(bench, all_effects()["noise-tails"])[0]
    assert {BPMS[place] for place in found.cause.places} == {n for n in BPMS if n.endswith("C09")}
    assert abs(found.cause.values["amplitude"] / size - 1.0) < 0.2


def test_a_crate_may_begin_to_be_late_in_the_middle_of_a_record():
    struck = [name for name in BPMS if name.endswith("C09")]
    record = record_with(f"bpm-latency:ticks=1,names={'+'.join(struck)},from=55s", dither=2e-3)
    found = best(record, "bpm-latency")
    assert [BPMS[place] for place in found.cause.places] == struck
    assert abs(found.cause.onset - 350) < 30  # the record begins after 20 s


def test_what_begins_late_in_a_crate_is_tried_at_all_its_sizes():
    struck = [name for name in CORRECTORS if name.endswith("C09")]
    effect = f"corrector-deadband:width=3mA,names={'+'.join(struck)},from=65s"
    bench = Bench(record_with(effect, dither=2e-3))
    found, *_ = tournament(bench, [all_effects()["corrector-deadband"]])
    assert [CORRECTORS[place] for place in found.cause.places] == struck
    assert abs(found.cause.onset - 450) < 40
    assert 2e-3 < found.cause.values["width"] < 4.5e-3


BOUNDED = (
    *("corrector-deadband", "corrector-hysteresis", "corrector-lag", "corrector-saturation"),
    *("bpm-lowpass", "bpm-nonlinearity", "corrector-gain", "quadrupole-gradient", "thermal-drift"),
)


@pytest.mark.parametrize("name", BOUNDED)
@pytest.mark.parametrize("dither", [0.0, 3e-3])
def test_what_a_change_tells_is_never_less_than_its_steps_say(name: str, dither: float):
    record = record_with("corrector-lag:tau=0.1s,cells=C05", dither=dither, ticks=400)
    scoring, kind = Scoring(Bench(record)), all_effects()[name]
    for values in kind.grid(record):
        changes = scoring.changes(kind, values)
        information, absorbed = changes.information
        known = information * (1.0 - absorbed)
        assert np.all(changes.least <= 1.001 * known + 1e-9)
        assert np.any(changes.least > 0.0) or not np.any(known > 1e-3)


def test_what_cells_tell_together_is_hardly_less_than_their_steps_say():
    record = record_with("corrector-lag:tau=0.1s,cells=C05", dither=3e-3, ticks=400)
    scoring, kind = Scoring(Bench(record)), all_effects()["corrector-deadband"]
    cells = list(record.layout.correctors.groups().values())
    for values in kind.grid(record):
        changes = scoring.changes(kind, values)
        least, known = changes.least_together(cells), scoring.together(changes, cells)
        assert np.all(least <= 1.05 * known + 1e-9)


@pytest.mark.parametrize(("size", "begin"), [(20, 80), (4, 99)])
def test_a_line_that_begins_late_is_found_from_there_on(size, begin):
    wave = f"cosine={size}nrad,sine=0rad,frequency=1.234Hz,names=QL2A_C17"
    swings = f"periodic-disturbance:{wave},from={begin}s"
    record = record_with(swings, dither=0.0, ticks=900)
    kind = all_effects()["periodic-disturbance"]
    (one,) = search(record, [kind]).winners
    cause, fitted = one.accepted.cause, one.accepted.fit
    assert abs(cause.onset - 10 * (begin - 20)) <= 6  # the record begins after 20 s
    assert "_C17" in kind.places_of(LAYOUT)[cause.places[0]]
    (index,) = (i for i, (_, p) in enumerate(fitted.parameters) if p.name == "frequency")
    low, high = fitted.interval(index)
    # of 30 s a line of 1,400 nats is known far within 1/30 Hz, of 11 s one of 50 within 1/11 Hz
    assert low == pytest.approx(1.234, abs=2e-3 if begin == 80 else 0.03)
    assert high == pytest.approx(1.234, abs=2e-3 if begin == 80 else 0.03)


def test_a_bpm_may_be_bent_from_a_row_on():
    bends = f"bpm-nonlinearity:quadratic=3000,names={BPMS[20]},from=60s"
    found = Scanner(Bench(record_with(bends, dither=1e-3))).candidates(
        all_effects()["bpm-nonlinearity"]
    )
    assert found[0].cause.places == (20,)
    assert abs(found[0].cause.onset - 400) <= 4


@pytest.mark.parametrize("begin", [0, 40])
def test_what_leaks_into_a_neighbour_is_not_told_for_what_leaks_further(begin):
    first, second = "CM1B_C02", "CM1A_C02"
    response, names = LAYOUT.response, LAYOUT.correctors.names
    near = np.corrcoef(response[:, [names.index(first), names.index(second)]].T)[0, 1]
    assert abs(near) > 0.9  # most of it is what a gain of the first one does, as healthy ones have
    leak = f"corrector-crosstalk:share=0.2,names={first}+{second}"
    record = record_with(leak + (f",from={begin}s" if begin else ""), dither=1e-3)
    kind = all_effects()["corrector-crosstalk"]
    found = Scanner(Bench(record)).candidates(kind)
    pairs = [tuple(names[i] for i in kind.pairs(LAYOUT)[one.cause.places[0]]) for one in found]
    assert pairs[0] == (first, second)
