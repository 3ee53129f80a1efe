"""The running figures against figures computed by hand from the same records."""

import math
import threading

import numpy as np
import pytest
from observe_records import channels, feed, record, report

from orbitfb.core.refit import Decision
from orbitfb.core.signals import LoopState
from orbitfb.observe.statistics.running import LoopStatistics
from orbitfb.observe.statistics.windows import LATENCY_BOUNDS


def test_before_the_first_tick_nothing_is_claimed(statistics, clock):
    clock.advance(3.0)
    shot = statistics.snapshot()
    assert shot.state is None
    assert shot.ticks.ticks == 0
    assert shot.ticks.age == pytest.approx(3.0)
    unknown = [shot.orbit.first, shot.orbit.observed.now, shot.orbit.true.window]
    unknown += [shot.latency.p50, shot.ticks.period, shot.correctors.setpoint, shot.orbit.time]
    assert all(math.isnan(value) for value in unknown)


def test_rms_counts_valid_bpms_only_and_is_of_the_error(statistics):
    statistics(record(error=(3e-6, 4e-6, 500e-6, 0.0), valid=(True, True, False, False)))
    orbit = statistics.snapshot().orbit
    assert orbit.observed.now == pytest.approx(math.sqrt(12.5) * 1e-6)
    assert (orbit.masked, orbit.invalid, orbit.bpms) == (0, 2, 4)
    assert orbit.worst_bpm == "BPM1"
    assert orbit.worst == pytest.approx(4e-6)


def test_no_valid_bpm_at_all_is_unknown_not_zero(statistics):
    statistics(record(valid=(False,) * 4))
    orbit = statistics.snapshot().orbit
    assert math.isnan(orbit.observed.now)
    assert math.isnan(orbit.observed.window)
    assert (orbit.invalid, orbit.worst_bpm) == (4, "")


def test_a_bpm_that_is_masked_by_configuration_is_not_invalid(clock):
    counting = np.array([True, False, True, True])
    statistics = LoopStatistics(channels(), 18.0, clock, counting)
    assert statistics.snapshot().orbit.masked == 1  # before the first orbit too
    statistics(record(valid=(True, False, False, True)))
    orbit = statistics.snapshot().orbit
    assert (orbit.masked, orbit.invalid, orbit.bpms) == (1, 1, 4)
    statistics.enabled = lambda: np.array([True, True, False, True])  # nor one that is disabled
    assert statistics.snapshot().orbit.invalid == 0


def test_planes_are_told_apart(clock):
    statistics = LoopStatistics(channels("xy"), 18.0, clock)
    statistics(record(error=(1e-6, -1e-6, 7e-6, 7e-6)))
    planes = statistics.snapshot().orbit.planes
    assert planes["x"].now == pytest.approx(1e-6)
    assert planes["y"].now == pytest.approx(7e-6)
    assert statistics.snapshot().orbit.observed.now == pytest.approx(5e-6)


def test_window_is_the_quadratic_mean_of_the_last_ten_seconds_of_stamps(statistics, clock):
    sizes = {tick: 100e-6 / tick for tick in range(1, 301)}
    feed(statistics, clock, 300, error=lambda k: (sizes[k],) * 4, true=lambda k: sizes[k] / 2)
    orbit = statistics.snapshot().orbit
    last = np.array([sizes[k] for k in range(201, 301)])
    # 100 stamps of 0.1 s; a stamp exactly 10 s old may fall on either side by rounding
    assert orbit.observed.window == pytest.approx(np.sqrt(np.mean(last**2)), rel=0.01)
    assert orbit.true.window == pytest.approx(np.sqrt(np.mean(last**2)) / 2, rel=0.01)
    assert orbit.first == pytest.approx(100e-6)
    assert orbit.observed.now == pytest.approx(sizes[300])


def test_window_is_in_time_whatever_the_rate(statistics, clock):
    feed(statistics, clock, 1000, period=0.01, error=(8e-6,) * 4)
    feed(statistics, clock, 11, period=1.0, error=(1e-6,) * 4)
    assert statistics.snapshot().orbit.observed.window == pytest.approx(1e-6)


def test_a_machine_clock_set_back_does_not_freeze_the_window(statistics):
    statistics(record(1, error=(9e-6,) * 4, time=5000.0))
    statistics(record(2, error=(1e-6,) * 4, time=1000.0))
    assert statistics.snapshot().orbit.observed.window == pytest.approx(1e-6)


def test_a_lost_orbit_makes_now_unknown_and_keeps_the_window(statistics):
    statistics(record(1, valid=(True, True, True, False)))
    statistics(record(2, lost=True, missed=1, state=LoopState.HELD, reason="no orbit"))
    shot = statistics.snapshot()
    assert math.isnan(shot.orbit.observed.now)
    assert shot.orbit.observed.window == pytest.approx(1e-6)
    assert shot.orbit.invalid == 1
    assert shot.auxiliary == {}
    assert (shot.state, shot.reason, shot.ticks.missed) == (LoopState.HELD, "no orbit", 1)


def test_latency_percentiles_and_histogram(statistics, clock):
    feed(statistics, clock, 100, latency=lambda k: k * 1e-3)
    statistics(record(101, time=clock.wall()))  # wrote nothing: no latency
    latency = statistics.snapshot().latency
    assert latency.p50 == pytest.approx(np.percentile(np.arange(1, 101) * 1e-3, 50))
    assert latency.p99 == pytest.approx(np.percentile(np.arange(1, 101) * 1e-3, 99))
    assert latency.largest == pytest.approx(0.1)
    assert latency.total == pytest.approx(5.05)
    expected = [sum(k * 1e-3 <= bound for k in range(1, 101)) for bound in LATENCY_BOUNDS]
    assert list(latency.buckets) == [*expected, 100]


def test_period_and_jitter_leave_out_what_spans_a_missed_orbit(statistics, clock):
    moments = [0.0, 0.1, 0.2, 0.31, 0.40, 0.9, 1.0]
    for tick, moment in enumerate(moments):
        statistics(record(tick, time=clock.wall() + moment, received=moment, missed=int(tick == 5)))
    ticks = statistics.snapshot().ticks
    intervals = [0.1, 0.1, 0.11, 0.09, 0.1]
    assert ticks.period == pytest.approx(np.mean(intervals))
    assert ticks.jitter == pytest.approx(np.std(intervals, ddof=1))


def test_states_are_counted_when_they_are_entered(statistics, clock):
    states = [LoopState.OPEN, LoopState.CLOSED, LoopState.CLOSED, LoopState.HELD, LoopState.CLOSED]
    for tick, state in enumerate(states):
        clock.advance(1.0)
        statistics(record(tick, state=state, reason="no orbit" if state == "HELD" else ""))
    clock.advance(2.5)
    shot = statistics.snapshot()
    assert shot.entries[LoopState.CLOSED] == 2
    assert shot.entries[LoopState.TRIPPED] == 0
    assert shot.in_state == pytest.approx(2.5)
    texts = [happening.text for happening in shot.happenings]
    assert texts == ["OPEN", "CLOSED", "HELD: no orbit", "CLOSED"]


def test_swaps_refits_and_limits(statistics):
    statistics(record(1))
    statistics(record(2, policy_id="refit-0001", scale=0.25))
    statistics(record(3, policy_id="refit-0001"))
    statistics.refitted(report(Decision.REFUSED))
    statistics.refitted(report(Decision.PROMOTED, 2))
    statistics.refitted(report(Decision.REFUSED, 3))
    shot = statistics.snapshot()
    assert (shot.swaps, shot.policy_id, shot.correctors.limited) == (1, "refit-0001", 1)
    assert shot.refits == {
        Decision.PROMOTED: 1,
        Decision.ACCEPTED: 0,
        Decision.REFUSED: 2,
        Decision.ROLLED_BACK: 0,
    }
    assert shot.last_refit is not None
    assert shot.last_refit.number == 3


def test_nearest_corrector_is_relative_to_its_own_limit_and_after_the_change(clock):
    statistics = LoopStatistics(channels(), np.array([18.0, 18.0, 2.0]), clock)
    statistics(record(setpoints=(10.0, -12.0, 1.2), applied=(0.0, 0.0, 0.3)))
    nearest = statistics.snapshot().correctors
    assert nearest.name == "COR2"
    assert nearest.setpoint == pytest.approx(1.5)
    assert nearest.limit == pytest.approx(2.0)


def test_snapshots_can_be_taken_while_ticks_come(statistics, clock):
    failures = []

    def look():
        try:
            for _ in range(200):
                shot = statistics.snapshot()
                assert shot.latency.buckets[-1] == shot.ticks.ticks
        except (RuntimeError, AssertionError) as error:
            failures.append(error)

    threads = [threading.Thread(target=look) for _ in range(2)]
    for thread in threads:
        thread.start()
    feed(statistics, clock, 2000, period=0.01, latency=1e-3)
    for thread in threads:
        thread.join()
    assert not failures
