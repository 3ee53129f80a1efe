"""The screen says nothing of clean records, and what is certain of broken ones."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.simulate import simulate_record
from orbitfb.diagnose.screen.channels import _evened, _turned
from orbitfb.diagnose.screen.order import check_order
from orbitfb.diagnose.screen.run import is_hopeless, screen
from orbitfb.diagnose.screen.steps import Steps
from orbitfb.diagnose.screen.writes import check_writes
from orbitfb.diagnose.verdict.proved import proved
from orbitfb.physics.effect import Effect
from orbitfb.physics.plant import PlantSettings
from tests.unit.records.record_files import record, ring

CLEAN = (
    {},
    {"dither": 1e-4},
    {"planes": "y", "gain": 0.8},
    {"gain": 0.05, "steering": 0},
    {"readback": True, "plant": PlantSettings(bpm_noise_rms=1e-6)},
)


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(2, 20))]
)
def test_a_clean_record_gives_no_finding(seed):
    made = simulate_record(ring(), ticks=600, seed=seed, **CLEAN[seed % len(CLEAN)])
    assert screen(made) == []


@pytest.mark.nightly
def test_a_clean_record_in_both_planes_gives_no_finding():
    assert screen(record("xy", ticks=400, dither=2e-5)) == []


class Sensing(Effect):
    """Any change of the readings."""

    def __init__(self, change):
        self.change = change

    def sense(self, orbit, tick):
        return self.change(orbit.copy())


class Acting(Effect):
    """Any change of the currents."""

    def __init__(self, change):
        self.change = change

    def actuate(self, setpoints, tick):
        return self.change(setpoints.copy())


def turn(column):
    def change(values):
        values[column] *= -1.0
        return values

    return change


def swap(first, second):
    def change(values):
        values[[first, second]] = values[[second, first]]
        return values

    return change


def memory(share):
    kept = []

    def change(values):
        before = kept[-1] if kept else values
        kept.append(share * before + (1.0 - share) * values)
        return kept[-1]

    return change


def only(made, check):
    """The one finding that there is."""
    (found,) = screen(made)
    assert found.check == check
    return found


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("effect", "proven", "devices"),
    [
        (Sensing(turn(40)), "bpm-polarity", ["PL2B_C06 (x)"]),
        (Sensing(swap(40, 100)), "bpm-swap", ["PL2B_C06 (x)", "PL2B_C16 (x)"]),
        (Acting(turn(70)), "corrector-polarity", ["CH2B_C11 (x)"]),
        (Acting(swap(70, 120)), "corrector-swap", ["CH2B_C11 (x)", "CH1A_C20 (x)"]),
    ],
)
def test_turned_and_swapped_channels(effect, proven, devices):
    found = only(simulate_record(ring(), ticks=1000, effects=(effect,)), "channels")
    assert found.severity == "warning"
    assert found.effect == proven
    assert list(found.devices) == devices


class Staying(Effect):
    """A corrector that stays where it is from a tick on, while its setpoint runs away."""

    def __init__(self, column, since):
        self.column, self.since, self.value = column, since, None

    def actuate(self, setpoints, tick):
        current = setpoints.copy()
        if tick >= self.since:
            self.value = current[self.column] if self.value is None else self.value
            current[self.column] = self.value
        return current


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("effect", "gain", "dither", "proven", "devices"),
    [
        (Acting(swap(13, 17)), 0.02, 3e-4, "corrector-swap", ["CH2A_C02 (x)", "CL1B_C02 (x)"]),
        (Sensing(swap(172, 173)), 0.05, 0.0, "bpm-swap", ["PL2B_C28 (x)", "PL1B_C28 (x)"]),
    ],
)
def test_of_what_fits_while_a_loop_runs_away_the_best_is_told(
    effect, gain, dither, proven, devices
):
    """Then all correctors move in proportion: a neighbour, or two signs, are nearly as good."""
    made = simulate_record(ring(), ticks=600, seed=2, effects=(effect,), gain=gain, dither=dither)
    found = only(made, "channels")
    assert (found.effect, list(found.devices)) == (proven, devices)


def test_a_few_rows_of_running_away_do_not_turn_the_model():
    random = np.random.default_rng(1)
    predicted = 1e-6 * random.standard_normal((300, 40))
    orbit = predicted + 1e-7 * random.standard_normal((300, 40))
    predicted[-8:] *= 1e4
    orbit[-8:] = -predicted[-8:]
    steps = Steps(np.arange(300), orbit, np.zeros((300, 3)), predicted)
    assert [one.check for one in _turned(steps, np.zeros((40, 3)))] == ["wrong-sign"]
    assert _turned(_evened(steps), np.zeros((40, 3))) == []


def test_a_dead_corrector_is_no_swap_with_one_that_makes_up_for_it():
    made = simulate_record(ring(), ticks=1000, effects=(Staying(100, 100),), gain=0.5)
    assert screen(made) == []


def in_proportion(effect, seed=1):
    """A record in which all correctors move up and down together."""
    random = np.random.default_rng(seed)
    moves = np.outer(random.standard_normal(400), 0.02 * random.standard_normal(180))
    return simulate_record(ring(), ticks=300, seed=5, effects=(effect,), excitation=moves)


def partly(column, share):
    def change(values):
        values[column] *= share
        return values

    return change


@pytest.mark.parametrize(
    "effect", [lambda: Acting(partly(7, 0.1)), lambda: Acting(memory(0.6)), lambda: Staying(7, 210)]
)
def test_magnets_that_move_in_proportion_are_no_proof_of_a_wrong_sign(effect):
    assert screen(in_proportion(effect())) == []


@pytest.mark.parametrize(
    ("change", "proven"), [(turn(7), "corrector-polarity"), (swap(7, 9), "corrector-swap")]
)
def test_a_wrong_sign_is_seen_among_magnets_that_move_in_proportion(change, proven):
    assert only(in_proportion(Acting(change)), "channels").effect == proven


@pytest.mark.parametrize("dither", [pytest.param(0.0, marks=pytest.mark.nightly), 1e-4])
@pytest.mark.parametrize(
    "effect",
    [
        lambda: Acting(lambda u: 0.6 * u),
        lambda: Sensing(memory(0.6)),
        *(
            pytest.param(effect, marks=pytest.mark.nightly)
            for effect in (
                lambda: Acting(memory(0.6)),
                lambda: Sensing(lambda y: 1.5 * y),
                lambda: Sensing(lambda y: 1e-7 * np.round(y / 1e-7)),
                lambda: Acting(lambda u: 1e-4 * np.round(u / 1e-4)),
            )
        ),
    ],
)
def test_other_effects_are_left_to_the_tournament(effect, dither):
    made = simulate_record(ring(), ticks=800, effects=(effect(),), dither=dither)
    assert screen(made) == []


def test_a_frozen_bpm():
    made = record(ticks=400)
    readings = made.readings.copy()
    readings[150:, 33] = np.median(readings[:150, 33])
    readings[200] = readings[199]  # an orbit that was missed does not thaw it
    frozen, missed = sorted(
        screen(replace(made, readings=readings)), key=lambda finding: finding.check
    )
    assert (frozen.check, frozen.effect) == ("frozen-bpm", "bpm-stuck")
    assert frozen.devices == (made.layout.bpms.label(33),)
    assert frozen.rows == (150, 400)
    assert (missed.check, missed.effect, missed.rows) == ("repeated-orbit", "", (200, 200))


@pytest.mark.parametrize("late", [slice(40, 44), slice(None)])
def test_where_a_delay_begins_no_reading_was_missed(late):
    """Readings that are late by a tick from a row on repeat there, once."""
    made = record(ticks=400)
    readings = made.readings.copy()
    readings[150:, late] = made.readings[149:-1, late]
    kept = replace(made, readings=readings)
    (found,) = screen(kept)
    assert (found.effect, found.rows) == ("", (150, 150))
    assert "a delay of one tick begins there" in found.text
    assert proved(kept, [found], frozenset()).causes == ()


def test_a_crate_that_is_not_read_at_some_ticks():
    made = record(ticks=400)
    readings = made.readings.copy()
    crate, rows = [40, 41, 42, 43], [60, 61, 150, 333]
    for row in rows:
        readings[row, crate] = readings[row - 1, crate]
    readings[250, 7] = readings[249, 7]  # by itself, once: nothing can be said of it
    kept = replace(made, readings=readings)
    (found,) = screen(kept)
    labels = tuple(made.layout.bpms.label(column) for column in crate)
    assert (found.check, found.effect, found.devices) == ("repeated-crate", "missed-read", labels)
    assert found.rows == (60, 333)
    certain = proved(kept, [found], frozenset())
    assert [cause.effect for cause in certain.causes] == ["missed-read"]
    filled = np.zeros(readings.shape, dtype=bool)
    filled[np.ix_(rows, crate)] = True
    np.testing.assert_array_equal(certain.record.filled, filled)
    off = np.abs(certain.record.readings - made.readings)
    assert np.median(off[filled]) < 2.0 * np.median(np.abs(np.diff(made.readings, axis=0)))
    np.testing.assert_array_equal(certain.record.readings[~filled], readings[~filled])


@pytest.mark.parametrize(
    ("together", "rows", "crate"),
    [(3, 1, False), (3, 4, True), pytest.param(8, 1, True, marks=pytest.mark.nightly)],
)
def test_readings_in_single_precision_repeat_at_once_by_chance(together, rows, crate):
    """As often as 120 lone ones of 540,000 let it."""
    made = record()
    readings, rng = made.readings.copy(), np.random.default_rng(9)
    count, n = readings.shape
    lone = rng.choice(np.arange(20, count - 20, 3), max(count * n // 4500, 20), replace=False)
    for row in lone:
        column = rng.integers(n)
        readings[row, column] = readings[row - 1, column]
    for row in np.setdiff1d(np.arange(20, count - 20), [*lone, *lone - 1, *lone + 1])[:rows]:
        readings[row, 40 : 40 + together] = readings[row - 1, 40 : 40 + together]
    found = screen(replace(made, readings=readings))
    assert any(one.check == "repeated-crate" for one in found) == crate


def test_all_bpms_frozen_make_a_diagnosis_nonsense():
    made = record(ticks=400)
    readings = made.readings.copy()
    readings[100:] = readings[100]
    found = screen(replace(made, readings=readings))
    assert is_hopeless(found)
    assert found[0].check == "frozen-orbit"


def test_orbits_that_never_move_are_not_readings_of_few_bits():
    made = record(ticks=400)
    found = screen(replace(made, readings=np.zeros_like(made.readings)))
    assert is_hopeless(found)
    assert found[0].check == "frozen-orbit"


def logged(made, columns, band):
    """What an archive with a dead-band keeps of readings: they stay until they changed by it."""
    readings = made.readings.copy()
    for row in range(1, len(readings)):
        small = np.abs(made.readings[row] - readings[row - 1]) < band
        same = np.isin(np.arange(len(small)), columns) & small
        readings[row, same] = readings[row - 1, same]
    return replace(made, readings=readings)


def test_readings_that_an_archive_held_are_told_together():
    made = record(ticks=400)
    crate = range(30, 42)
    found = only(logged(made, crate, 0.3e-6), "held-readings")
    assert found.severity == "warning"
    assert found.effect == ""
    assert found.devices == tuple(made.layout.bpms.label(column) for column in crate)


def test_an_archive_that_held_most_readings_is_no_record_of_the_orbit():
    made = record(ticks=400)
    found = only(logged(made, range(150), 1.5e-6), "held-readings")
    assert found.severity == "failure"
    assert is_hopeless([found])


def test_a_few_repeats_are_no_more_than_a_note():
    made = record(ticks=400)
    readings = made.readings.copy()
    readings[100:110:2, 33] = readings[99:109:2, 33]
    assert only(replace(made, readings=readings), "repeated-readings").severity == "note"


def test_readings_of_few_bits_are_not_frozen():
    made = record(ticks=600, steering_rms=30e-6)
    readings = 1e-6 * np.round(made.readings / 1e-6)
    found = only(replace(made, readings=readings), "coarse-readings")
    assert found.effect == ""


def test_a_clipped_bpm():
    made = record(ticks=600)
    readings = made.readings.copy()
    limit = np.quantile(readings[:, 8], 0.8)
    readings[:, 8] = np.minimum(readings[:, 8], limit)
    found = only(replace(made, readings=readings), "rail")
    assert found.devices == (made.layout.bpms.label(8),)
    assert found.effect == ""


def frozen_at_its_largest(made, step=0.0):
    """A record one BPM of which stands still from row 300 on, where it never read further out."""
    readings = step * np.round(made.readings / step) if step else made.readings.copy()
    readings[300:, 8] = readings[:300, 8].max() + (step or 1e-9)
    if step:
        readings[[150, 299], 8] = readings[300, 8]
    return readings


@pytest.mark.parametrize("step", [0.0, 0.2e-6, 0.3e-6])
def test_a_bpm_that_froze_at_its_largest_reading_is_not_clipped(step):
    made = record(ticks=600, steering_rms=30e-6)  # on a grid it was there before, by chance
    found = screen(replace(made, readings=frozen_at_its_largest(made, step)))
    assert {each.check for each in found} <= {"frozen-bpm", "coarse-readings"}
    (frozen,) = [each for each in found if each.check == "frozen-bpm"]
    assert (frozen.devices, frozen.rows) == ((made.layout.bpms.label(8),), (300 - (step > 0), 600))


def test_a_row_that_was_lost_does_not_thaw_a_frozen_bpm():
    made = record(ticks=600)
    starts = made.starts.copy()
    starts[500] = True
    found = only(replace(made, readings=frozen_at_its_largest(made), starts=starts), "frozen-bpm")
    assert found.rows == (300, 600)


def test_writes_that_were_lost():
    made = record(ticks=300)
    requested = made.requested.copy()
    requested[[20, 90]] += 1e-4  # asked for, and not in the next setpoints
    setpoints = made.setpoints.copy()
    lost = replace(made, requested=requested)
    assert only(lost, "requested-not-applied").rows == (20, 90)
    for row in (20, 90):
        setpoints[row + 1 :] -= made.setpoints[row + 1] - made.setpoints[row]
    (found,) = [
        each for each in screen(replace(made, setpoints=setpoints)) if each.check == "lost-write"
    ]
    assert (found.rows, found.effect) == ((20, 90), "missed-write")


def test_a_single_row_is_told_in_the_singular():
    made = record(ticks=300)
    readings = made.readings.copy()
    readings[200] = readings[199]
    assert "in 1 row (first" in only(replace(made, readings=readings), "repeated-orbit").text


def test_a_setpoint_that_stays():
    made = record(ticks=300)
    setpoints = made.setpoints.copy()
    setpoints[100:, 5] = setpoints[100, 5]
    (found,) = [
        each
        for each in screen(replace(made, setpoints=setpoints))
        if each.check == "frozen-setpoint"
    ]
    assert found.effect == "corrector-stuck"
    assert found.devices == (made.layout.correctors.label(5),)
    assert found.rows == (100, 300)


def test_setpoints_of_another_row():
    made = record(ticks=300)
    after = np.roll(made.setpoints, -1, axis=0)
    found = screen(made.rows(0, 300))
    assert found == []
    found = screen(replace(made, setpoints=after).rows(0, 299))
    assert is_hopeless(found)
    assert found[0].check == "shifted-setpoints"


@pytest.mark.parametrize(
    ("factor", "check", "words"),
    [
        (1e3, "wrong-units", "'action' is 1000 times the change of 'setpoint'"),
        (1e-3, "wrong-units", "is setpoint in mA?"),
        (-1.0, "wrong-sign", "with the opposite sign"),
    ],
)
def test_actions_in_another_unit_or_with_another_sign(factor, check, words):
    made = record(ticks=300)
    found = only(replace(made, requested=factor * made.requested), check)
    assert is_hopeless([found])
    assert words in found.text


def test_setpoints_of_another_record_than_the_actions():
    made = record(ticks=300)
    found = only(replace(made, setpoints=made.setpoints[::-1]), "foreign-action")
    assert is_hopeless([found])


def changed(made, change):
    """The record whose setpoints move by what something makes of the changes asked for."""
    steps = change(made.requested[:-1])
    return replace(made, setpoints=np.vstack([0 * steps[:1], np.cumsum(steps, axis=0)]))


@pytest.mark.parametrize(
    "change",
    [
        lambda asked: asked + 3.0 * asked.std() * np.random.default_rng(1).normal(size=asked.shape),
        lambda asked: np.clip(asked, -0.1 * asked.std(), 0.1 * asked.std()),
        lambda asked: np.roll(asked, 2, axis=0),
    ],
)
def test_setpoints_that_follow_among_other_writes_within_limits_or_late(change):
    made = record(ticks=300)
    assert not is_hopeless(
        [one for one in check_writes(changed(made, change)) if one.check == "foreign-action"]
    )


def test_rounded_setpoints_are_a_note():
    made = record(ticks=300)
    setpoints = 1e-6 * np.round(made.setpoints / 1e-6)
    assert only(replace(made, setpoints=setpoints), "rounded-setpoints").severity == "note"


def test_stuck_and_clipped_readbacks():
    made = record(ticks=800, readback=True, steering_rms=30e-6)
    readback = made.readback.copy()
    readback[400:, 3] = np.median(readback[:, 3])
    stuck = only(replace(made, readback=readback), "readback-stuck")
    assert (stuck.effect, stuck.devices) == (
        "corrector-stuck",
        (made.layout.correctors.label(3),),
    )
    readback = made.readback.copy()
    readback[:, 6] = np.minimum(readback[:, 6], np.quantile(readback[:, 6], 0.7))
    clipped = only(replace(made, readback=readback), "readback-clipped")
    assert clipped.effect == "corrector-saturation"


def test_a_clock_that_trembles_or_lies():
    made = record(ticks=400)
    rng = np.random.default_rng(0)
    time = made.time + 0.01 * rng.standard_normal(401)
    assert only(replace(made, time=time), "stamp-jitter").severity == "note"
    assert only(replace(made, time=made.time * 1.5), "period").severity == "warning"


@pytest.mark.parametrize("factor", [1e-3, 1e3, 1e6])
@pytest.mark.parametrize("dither", [0.0, 1e-4])
def test_an_orbit_in_another_unit(factor, dither):
    made = record(ticks=400, dither=dither)
    found = screen(replace(made, readings=made.readings * factor))
    assert is_hopeless(found)
    assert found[0].check == "wrong-units"


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_a_model_in_another_unit(factor):
    made = record(ticks=400)
    layout = replace(made.layout, response=made.layout.response * factor)
    found = screen(replace(made, layout=layout))
    assert is_hopeless(found)
    assert {each.check for each in found} == {"wrong-units", "model-scale"}


def test_a_model_of_the_other_plane_or_turned_over():
    made = record(ticks=400, dither=1e-4)
    other = record("y", ticks=400).layout.response
    wrong = {
        "swapped-planes": other,
        "transposed-model": made.layout.response.T,
        "strange-model": np.random.default_rng(0).permutation(made.layout.response),
    }
    for check, response in wrong.items():
        found = screen(replace(made, layout=replace(made.layout, response=response.copy())))
        assert check in {each.check for each in found}


def test_columns_in_another_order_or_with_the_other_sign():
    made = record(ticks=400, dither=1e-4)
    order = np.random.default_rng(0).permutation(180)
    found = screen(replace(made, readings=made.readings[:, order]))
    assert found[0].check == "permuted-channels"
    assert is_hopeless(found)
    assert screen(replace(made, readings=-made.readings))[0].check == "wrong-sign"


# What a loop moves to hold noise and drift alone tells an order in some records and not in others.
@pytest.mark.parametrize("dither", [3e-5, 1e-4])
@pytest.mark.parametrize("shift", [0, 1])
def test_correctors_in_another_order_are_not_blamed_on_the_bpms(dither, shift):
    made = record(ticks=400, dither=dither)
    order = np.roll(np.arange(180), shift) if shift else np.random.default_rng(0).permutation(180)
    found = only(
        replace(made, setpoints=made.setpoints[:, order], requested=made.requested[:, order]),
        "permuted-channels",
    )
    assert found.severity == "failure"
    assert "columns of 'setpoint' (and 'action') are not in the order of corr_names" in found.text


def test_bpms_in_another_order_are_not_blamed_on_the_correctors():
    made = record(ticks=400)
    found = only(replace(made, readings=np.roll(made.readings, 1, axis=1)), "permuted-channels")
    assert "columns of 'orbit' are not in the order of bpm_names" in found.text
    assert "setpoint" not in found.text


def test_an_order_that_may_be_of_either_is_told_of_neither():
    """On a ring of equal cells a turn of the BPMs and one of the correctors are the same."""
    rng = np.random.default_rng(5)
    response = 1e-3 * np.cos(2 * np.pi * np.subtract.outer(np.arange(24), np.arange(24)) / 24)
    response += 1e-3 * np.cos(10 * np.pi * np.subtract.outer(np.arange(24), np.arange(24)) / 24)
    setpoints = rng.normal(size=(300, 24))
    predicted = setpoints @ response.T
    orbit = np.roll(predicted, 3, axis=1) + 1e-5 * rng.normal(size=predicted.shape)
    (found,) = check_order(Steps(np.arange(300), orbit, setpoints, predicted), response)
    assert "this record does not show which of the two" in found.text


def test_setpoints_that_never_move():
    made = record(ticks=200)
    still = replace(
        made,
        setpoints=np.zeros_like(made.setpoints),
        requested=np.zeros_like(made.requested),
    )
    assert only(still, "no-action").severity == "warning"


@pytest.mark.parametrize(("turn", "told"), [(0.12, []), (1.0, ["permuted-channels"])])
def test_bpms_that_follow_their_neighbours_a_little_better_are_in_order(turn, told):
    """One corrector that is stuck turns the steps of all BPMs alike while an orbit is corrected."""
    rng = np.random.default_rng(4)
    courses, phase = rng.normal(size=(400, 2)), np.linspace(0.0, 2 * np.pi, 60, endpoint=False)

    def response(phases):
        return np.array([np.cos(phases), np.sin(phases)]).T

    orbit, predicted = (courses @ response(phases).T for phases in (phase + turn, phase))
    made = Steps(np.arange(400), orbit, courses, predicted)
    assert [finding.check for finding in check_order(made, response(phase))] == told


def small_ring(turned=(), boost=9):
    """Steps of 24 correctors of a ring of 30 BPMs at their own random walks, some turned."""
    rng = np.random.default_rng(6)
    bpms, magnets = (2 * np.pi * (np.arange(k) + rng.uniform(size=k)) / k for k in (30, 24))
    apart = np.abs(np.subtract.outer(bpms, magnets))
    sizes = np.sqrt(np.outer(rng.uniform(8, 20, 30), rng.uniform(8, 20, 24)))
    response = 1e-4 * sizes * np.cos(7.23 * (apart - np.pi)) / (2 * np.sin(7.23 * np.pi))
    setpoints = (
        1e-3 * rng.normal(size=(400, 24)) * np.where(np.isin(np.arange(24), turned), boost, 1)
    )
    signs = np.where(np.isin(np.arange(24), turned), -1.0, 1.0)
    orbit = (setpoints * signs) @ response.T + 5e-7 * rng.normal(size=(400, 30))
    return Steps(np.arange(400), orbit, setpoints, setpoints @ response.T), response


@pytest.mark.parametrize("turned", [(7,), (7, 15)])
def test_few_correctors_that_kick_the_wrong_way_are_no_other_order_or_sign(turned):
    steps, response = small_ring(turned)
    assert check_order(steps, response) == []
    assert _turned(steps, response) == []


@pytest.mark.parametrize(("turned", "boost"), [((0, 8, 16), 3), (tuple(range(0, 24, 3)), 1)])
def test_many_that_kick_the_wrong_way_are_no_other_order(turned, boost):
    """So it was with one that stood still while its loop asked it for more and more."""
    steps, response = small_ring(turned, boost)
    assert check_order(steps, response) == []


def test_all_of_them_are_a_wrong_sign():
    (found,) = _turned(*small_ring(tuple(range(24))))
    assert found.check == "wrong-sign"


def test_a_loop_that_ran_away_is_no_other_unit():
    made = record(ticks=400)
    away = made.readings.copy()
    away[300:] += 0.2
    found = only(replace(made, readings=away), "lost-beam")
    assert found.rows == (300, len(made) - 1)
    assert is_hopeless([found])
