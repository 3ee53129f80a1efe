"""The watch over the gap: it sees what is there, and keeps broken devices from the learner."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.simulate import simulate_record
from benchmarks.small_ring import small_ring
from orbitfb.core.errors import EstimationError
from orbitfb.core.gap import GapSight
from orbitfb.core.signals import Channels, Vector
from orbitfb.core.transitions import Transitions
from orbitfb.diagnose.live.broken import Broken, Screen, broken_at_sight, broken_rows, screened
from orbitfb.diagnose.live.look import look
from orbitfb.diagnose.live.rows import FEWEST, cut_at_jumps, record_of
from orbitfb.diagnose.live.watch import GapWatch
from orbitfb.diagnose.settings import LiveSettings
from orbitfb.effects.build import layout_of
from orbitfb.effects.registry import effect
from orbitfb.physics.disturbances import QuadrupoleOrbits
from orbitfb.physics.effect import Effect
from orbitfb.records.record import Record

RING = small_ring()
LAYOUT = layout_of(RING, "x", 0.1)
GENERATOR = np.random.default_rng(0)
CHANNELS = Channels("x", LAYOUT.bpms.names, LAYOUT.correctors.names, (), (), ())


class Kicked(Effect):
    """The whole orbit steps aside at a tick, as when an operator kicks the beam, and stays there.

    Args:
        rms: Of the step at the BPMs [m].
        at: Its tick.
    """

    def __init__(self, rms: float, at: int) -> None:
        rng = np.random.default_rng(5)
        self._step = QuadrupoleOrbits(RING, "x").draw_exactly(rng, rms)
        self._at = at

    def disturb(self, orbit: Vector, tick: int) -> Vector:
        return orbit + self._step if tick >= self._at else orbit


class Calibrated(Effect):
    """Every corrector with a gain of its own, as good as their makers state it: one per cent."""

    def __init__(self) -> None:
        self._gain = 1.0 + 0.01 * np.random.default_rng(6).standard_normal(len(LAYOUT.correctors))

    def actuate(self, setpoints: Vector, tick: int) -> Vector:
        return setpoints * self._gain


def transitions_of(record: Record, begin: float = 1e9) -> Transitions:
    rows = len(record) - 1
    n, m = record.layout.response.shape
    return Transitions(
        tick=np.arange(rows),
        time=begin + record.time[:-1],
        next_time=begin + record.time[1:],
        written=begin + record.time[:-1],
        orbit=record.readings[:-1],
        next_orbit=record.readings[1:],
        reference=np.zeros((rows, n)),
        valid=np.ones((rows, n), dtype=bool),
        requested=record.requested[:-1],
        applied=np.diff(record.setpoints, axis=0),
        dither=np.zeros((rows, m)),
        setpoints=record.setpoints[:-1],
        readback=record.setpoints[:-1],
        policy_id=np.full(rows, "svd"),
        closed=np.ones(rows, dtype=bool),
        hertz=np.zeros(rows),
        usable=np.ones(rows, dtype=bool),
        auxiliary={},
    )


def stuck_at_10() -> Record:
    rng = np.random.default_rng(0)
    its = effect("corrector-stuck").simulate(LAYOUT, np.array([10]), {"left": 0.0}, rng)
    return simulate_record(RING, ticks=400, seed=2, effects=[its])


@pytest.fixture(scope="module")
def stuck() -> tuple[Transitions, GapSight]:
    transitions = transitions_of(stuck_at_10())
    record = record_of(transitions, LAYOUT)
    assert record is not None
    assert np.array_equal(record.readings[:-1], transitions.orbit)
    return transitions, look(record, float(transitions.next_time[-1]))


def test_a_stuck_corrector_is_seen_and_named(stuck: tuple[Transitions, GapSight]) -> None:
    transitions, sight = stuck
    assert sight.resolved
    assert 0.0 < sight.low < sight.nats < sight.high
    assert sight.effect == "corrector-stuck"
    assert sight.places == (LAYOUT.correctors.names[10],)
    assert sight.probability > 0.9
    assert transitions.time[0] <= sight.since <= sight.time


def test_a_healthy_loop_has_no_gap() -> None:
    record = record_of(transitions_of(simulate_record(RING, ticks=400, seed=4)), LAYOUT)
    assert record is not None
    assert not look(record, 0.0).resolved


@pytest.mark.parametrize("rms", [5e-6, 50e-6, 200e-6])
def test_a_kick_by_an_operator_is_no_gap(rms: float) -> None:
    """The default of the tutorial is 50 µm; the gains of a healthy ring are off by one per cent."""
    kicked = simulate_record(RING, ticks=400, seed=5, effects=[Calibrated(), Kicked(rms, 350)])
    record = record_of(transitions_of(kicked), LAYOUT)
    assert record is not None
    assert np.flatnonzero(cut_at_jumps(record).starts).tolist()[:2] == [0, 150]
    assert not look(record, 0.0).resolved


def test_a_ring_that_jumps_all_the_time_is_taken_as_it_is() -> None:
    record = simulate_record(RING, ticks=400, seed=4)
    readings = record.readings.copy()
    readings[::40] += 1e-4
    jumping = replace(record, readings=readings)
    assert np.array_equal(cut_at_jumps(jumping).starts, record.starts)


@pytest.mark.nightly
def test_a_lag_of_all_correctors_is_named_though_no_single_one_shows_it() -> None:
    """Its grid has many values: it is tried where the memory of all devices shows."""
    its = effect("corrector-lag").simulate(
        LAYOUT, np.arange(len(LAYOUT.correctors)), {"tau": 0.05, "second": 0.0}, GENERATOR
    )
    record = record_of(
        transitions_of(simulate_record(RING, ticks=400, seed=6, effects=[its])), LAYOUT
    )
    assert record is not None
    sight = look(record, 0.0)
    assert sight.resolved
    # The loop shows the sum of both ends, and a lag of half a row is a delay of a part of one.
    assert sight.effect in ("corrector-lag", "bpm-lowpass", "loop-delay")
    assert sight.places == ()
    assert 0.0 < sight.low < sight.nats < sight.high


@pytest.mark.nightly
def test_no_window_of_a_healthy_loop_shows_a_gap() -> None:
    for seed in range(50):
        record = simulate_record(RING, ticks=600, seed=100 + seed, effects=[Calibrated()])
        sight = look(record, 0.0)
        assert not sight.resolved, (seed, sight)


def test_too_few_closed_ticks_are_not_looked_at() -> None:
    transitions = transitions_of(simulate_record(RING, ticks=FEWEST + 20, seed=4))
    assert record_of(transitions, LAYOUT) is not None
    closed = transitions.closed.copy()
    closed[:50] = False
    assert record_of(replace(transitions, closed=closed), LAYOUT) is None


def test_the_learner_gets_no_rows_of_a_stuck_corrector(
    stuck: tuple[Transitions, GapSight],
) -> None:
    transitions, sight = stuck
    broken = broken_at_sight(sight)
    assert [device.name for device in broken] == [LAYOUT.correctors.names[10]]
    kept = screened(transitions, broken, CHANNELS)
    moved = transitions.applied[:, 10] != 0.0
    late = transitions.time >= broken[0].since
    assert np.array_equal(kept.usable, ~(moved & late))
    assert np.array_equal(broken_rows(broken, transitions, CHANNELS), moved & late)
    assert kept.valid.all()


def test_a_broken_bpm_does_not_count_and_its_rows_still_teach(
    stuck: tuple[Transitions, GapSight],
) -> None:
    transitions, _ = stuck
    since = float(transitions.time[100])
    device = Broken("bpm-polarity", LAYOUT.bpms.names[7], "x", since)
    kept = screened(transitions, [device], CHANNELS)
    assert kept.valid[:100].all()
    assert not kept.valid[100:, 7].any()
    assert kept.valid[:, :7].all()
    assert kept.usable.all()


def test_an_inexact_device_is_left_to_the_learner() -> None:
    sight = GapSight(0.0, 400, 1.0, 0.5, 1.5, True, "corrector-gain", ("A",), ("x",), 1.0)
    assert broken_at_sight(sight) == ()
    doubtful = replace(sight, effect="corrector-stuck", probability=0.5)
    assert broken_at_sight(doubtful) == ()


class _History:
    def __init__(self, transitions: Transitions) -> None:
        self.transitions = transitions

    def snapshot(self, last: int | None = None, since_tick: int | None = None) -> Transitions:
        return self.transitions


def test_the_watch_publishes_once_per_new_tick_and_tells_the_screen(
    stuck: tuple[Transitions, GapSight],
) -> None:
    transitions, sight = stuck
    history, seen = _History(transitions), []
    watch = GapWatch(LiveSettings(), history, lambda _: sight, seen.append)
    assert watch.broken() == ()
    watch.step()
    watch.step()
    assert seen == [sight]
    screen = Screen(history, CHANNELS, watch.broken)
    assert not screen.snapshot().usable.all()
    off = GapWatch(LiveSettings(screen=False), history, lambda _: sight, seen.append)
    off.step()
    assert off.broken() == ()


def test_a_look_that_fails_is_told_and_the_watch_goes_on(
    stuck: tuple[Transitions, GapSight],
) -> None:
    failures: list[EstimationError] = []

    def fail(_: Transitions) -> GapSight:
        raise EstimationError("it died")

    watch = GapWatch(LiveSettings(), _History(stuck[0]), fail, lambda _: None, failures.append)
    watch.step()
    assert len(failures) == 1
