"""The parts of a gap add up to the whole; no gap is not resolved; a gain error is."""

import numpy as np
import pytest
from gap_cases import GAIN, PLACE, bench, gain_error, record

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.entry import Entry
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.gap import UNEXPLAINED, gap, surplus
from orbitfb.diagnose.gap_maps import lag_profile, maps
from orbitfb.diagnose.gap_parts import band_edges
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.diagnose.replay import NOMINAL, Model, Replay
from orbitfb.diagnose.unseen import Unseen
from orbitfb.diagnose.worth import Gains, shapley
from orbitfb.effects.registry import effect

TRUE = ((PLACE, GAIN),)


@pytest.fixture(scope="module")
def found():
    return bench(True, TRUE)


def _told(found):
    """The same bench with a floor told that is much too low: the rest is resolved."""
    floor = NoiseFloor(found.floor.modes, found.floor.reading / 2, found.floor.walk / 2)
    return Bench(found.record, found.causes, floor)


@pytest.mark.parametrize("told", [False, True])
def test_the_parts_add_up(found, told):
    unseen = Unseen({"noise": 3.0}, np.eye(180)[7] if told else None)
    whole = surplus(_told(found) if told else found, unseen=unseen)
    assert (whole.raw is not None) == told
    total = whole.by_row.sum()
    directions = np.linalg.svd(found.record.layout.response)[0]
    by_band = sum(band.sum() for band in whole.by_frequency(band_edges()))
    for parts in (whole.by_bpm(), whole.by_direction(directions), by_band):
        assert np.sum(parts) == pytest.approx(total, rel=1e-9)


def test_noise_lies_at_its_bpms():
    quiet = bench(False)
    kinds = (("noise-level", (7,)), ("bpm-walk", (9,)), ("corrector-gain", (3,)))
    entries = [
        Entry(Candidate(Cause(effect(kind), places, {}), gain, 1.0), None, gain)
        for (kind, places), gain in zip(kinds, (30.0, 60.0, 500.0), strict=True)
    ]
    unseen = Unseen.of(quiet, entries)
    assert unseen.by_stage == {"noise": 30.0, "sensor": 60.0}
    its = gap(quiet, unseen=unseen)
    names = quiet.record.layout.bpms.names
    assert its.by_bpm[names[7]] == pytest.approx(30.0 / 400, rel=1e-6)
    assert its.by_bpm[names[9]] == pytest.approx(60.0 / 400, rel=1e-6)
    assert sum(its.by_mode) == pytest.approx(90.0 / 400, rel=1e-5)


def test_the_parts_of_the_answer_add_up(found):
    its = gap(found, unseen=Unseen({"noise": 2.0}, np.eye(180)[7]), stage_gains={"sensor": 1.0})
    for parts in (
        its.by_stage.values(),
        its.by_bpm.values(),
        its.by_mode,
        [piece.nats_per_tick for piece in its.by_band],
        [piece.nats_per_tick for piece in its.by_window],
        *([piece.nats_per_tick for piece in binning.pieces] for binning in its.by_bin),
    ):
        assert sum(parts) == pytest.approx(its.nats_per_tick, rel=1e-5)


def test_sensor_causes_add_up_with_their_jacobian():
    one = Cause(effect("bpm-gain"), (7,), {"gain": 0.1})
    whole = surplus(Bench(record(False), [one]))
    assert np.any(whole.jacobian[:, 7])
    assert whole.by_bpm().sum() == pytest.approx(whole.by_row.sum(), rel=1e-9)


def test_a_gain_error_is_resolved_at_its_place(found):
    its = gap(found)
    assert its.resolved
    assert its.low < its.nats_per_tick < its.high
    assert its.um > 0.0
    assert its.um_low > 0.0
    names = found.record.layout.correctors.names
    assert max(its.by_corrector, key=its.by_corrector.get) == names[PLACE]
    assert its.by_stage["actuator"] == pytest.approx(its.nats_per_tick, rel=1e-6)
    assert abs(its.by_stage[UNEXPLAINED]) < 1e-9


def test_without_a_gap_nothing_is_resolved():
    its = gap(bench(False))
    assert not its.resolved
    assert its.nats_per_tick == 0.0
    assert its.um == 0.0


def test_a_wrong_cause_has_no_gap_of_its_own():
    assert not gap(bench(False, ((PLACE, 1.0),))).resolved


def test_shares_of_two_causes_add_up():
    causes = (gain_error(), gain_error(40, 0.05))
    both = Bench(record(True), causes)
    replay = Replay.of(both)
    gain = 0.5 * (np.sum(replay.white(NOMINAL) ** 2) - np.sum(replay.white(Model(causes)) ** 2))
    shares = shapley(Gains(both))
    assert sum(shares) == pytest.approx(gain, rel=1e-9)
    assert shares[0] > abs(shares[1])


def test_steps_ahead_begin_with_the_innovation(found):
    replay = Replay.of(found)
    innovation, _ = found.floor.innovations(
        found.record.readings
        - replay.healthy
        - found.record.setpoints @ found.record.layout.response.T,
        found.record.starts,
    )
    assert replay.errors(NOMINAL) == pytest.approx(found.floor.to_bpms(innovation), abs=1e-15)


@pytest.mark.parametrize("steps", [1, 2, 10])
def test_the_floor_of_many_steps_is_what_the_right_model_leaves(found, steps):
    replay = Replay.of(found)
    rows = replay.counted(steps + 50)
    left = np.mean(replay.errors(Model(found.causes), steps)[rows] ** 2)
    assert left == pytest.approx(replay.floor_variance(steps), rel=0.06)


def test_prediction_errors_of_late_readings_do_not_look_ahead():
    late = Cause(effect("bpm-latency"), (3,), {"ticks": 1.0})
    its = Bench(record(False), [late])
    replay = Replay.of(its)
    errors = replay.errors(Model((late,)))
    assert np.std(errors[2:, 3]) > np.std(replay.errors(NOMINAL)[2:, 3])


def test_maps_have_a_row_per_device(found):
    whole = surplus(found)
    first, second = maps(found, whole)
    assert len(first.values) == len(found.record.layout.bpms)
    assert len(second.values) == len(found.record.layout.correctors)
    peak = np.abs(np.array(second.values)[:, 0]).argmax()
    assert peak == PLACE
    assert len(lag_profile(found, whole).slope) == 8
