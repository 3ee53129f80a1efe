"""What the page shows is what the loop did, in the units of the PVs."""

import json
import math

import numpy as np
import pytest

from orbitfb.core.clock import ManualClock
from orbitfb.core.refit import Decision, RefitReport
from orbitfb.core.signals import Channels, LoopState, Orbit, Phases, Reading, TickRecord
from orbitfb.measure.progress import Progress, Stage
from orbitfb.observe.statistics.running import LoopStatistics
from orbitfb.page.peaks import Peaks
from orbitfb.page.view import PageView, Sources

NAMES = ("A", "B", "C", "D")
ORBIT = np.array([3e-6, -1e-6, np.nan, 5e-6])
REFERENCE = np.array([1e-6, 0.0, 0.0, 0.0])
ENABLED = np.array([True, True, True, False])


def record(clock, state=LoopState.CLOSED, orbit=ORBIT, policy="svd-1"):
    valid = np.isfinite(orbit)
    reading = Reading(Orbit(orbit, valid, 50.0), orbit, {"current": 0.4}, clock.monotonic())
    ones, phases = np.ones(4), Phases(0.09, 0.0, 0.0, 0.0, 0.0)
    return TickRecord(
        7, state, "why", reading, REFERENCE, ones, ones, 0 * ones, 0.5 * ones, 1.0, 50.0, policy,
        phases, 1e-3, 0,
    )  # fmt: skip


class Loop:
    def __init__(self):
        self.clock = ManualClock()
        self.statistics = LoopStatistics(
            Channels("x", NAMES, NAMES, NAMES, NAMES, NAMES), 18.0, self.clock
        )
        self.last, self.peaks = None, Peaks("x")
        self.hand_over = {"state": "HANDS OVER", "reason": "", "left_um": 3.1}
        sources = Sources(
            self.statistics.snapshot,
            lambda: self.last,
            lambda: ENABLED,
            lambda: np.array([True, False, True, True]),
            lambda snapshot: f"gap of {snapshot.ticks.ticks} ticks",
            self.peaks.since,
            0.2e-6,
            measurement=lambda: Progress(Stage.MEASURING, 12, 180, 0.0667, 790.0, "goes on"),
            hand_over=lambda: self.hand_over,
        )
        self.view = PageView(sources, self.clock, 5.0)

    def tick(self, **how):
        self.last = record(self.clock, **how)
        self.statistics(self.last)
        self.peaks(self.last)

    def shown(self):
        its = self.view()
        json.dumps(its, allow_nan=False)
        return its


@pytest.fixture
def loop():
    return Loop()


def test_before_the_first_tick_nothing_is_invented(loop):
    its = loop.shown()
    assert (its["state"], its["alive"], its["stamp"]) == (None, False, None)
    assert its["orbit_um"] == its["error_um"] == its["setpoints_A"] == []


def test_vectors_are_those_of_the_last_orbit(loop):
    loop.tick()
    its = loop.shown()
    assert its["orbit_um"] == [3.0, -1.0, None, 5.0]
    assert its["error_um"] == [2.0, -1.0, None, 5.0]
    assert its["bpms"] == "0012"  # D is left out by an operator, C has no reading
    assert its["setpoints_A"] == [1.5] * 4
    assert its["movable"] == "1011"
    assert (its["stamp"], its["orbit_tick"], its["alive"]) == (50.0, 7, True)


def test_figures_have_the_units_of_the_pvs(loop):
    loop.tick()
    its = loop.shown()
    assert its["rms_um"]["x"] == pytest.approx(math.sqrt((4 + 1 + 25) / 3))
    assert its["current_mA"] == pytest.approx(400.0)
    assert its["latency50_ms"] == pytest.approx(1.0)
    assert (its["worst_bpm"], its["worst_um"]) == ("D", pytest.approx(5.0))
    assert (its["policy"], its["reason"], its["ticks"]) == ("svd-1", "why", 1)
    assert its["gap"] == {"headline": "gap of 1 ticks", "resolved": False, "time": None}


def test_a_hand_over_is_shown_where_a_fast_feedback_takes_it(loop):
    assert loop.shown()["hand_over"] == {"state": "HANDS OVER", "reason": "", "left_um": 3.1}
    loop.hand_over = None
    assert loop.shown()["hand_over"] is None


def test_a_measurement_of_the_response_is_shown(loop):
    assert loop.shown()["measurement"] == {
        "state": "MEASURING", "running": True, "done": 12, "total": 180, "share": 0.0667,
        "left_s": 790.0, "text": "goes on",
    }  # fmt: skip


def test_an_excursion_of_one_tick_is_in_the_peak_of_those_who_ask_once_a_second(loop):
    def after(seconds):
        loop.clock.advance(seconds)
        loop.tick()

    after(0.1)
    loop.clock.advance(0.1)
    loop.tick(orbit=REFERENCE + 200e-6)
    after(0.1)
    after(0.9)
    its = loop.shown()
    assert its["rms_peak_um"]["x"] == pytest.approx(200.0) and its["rms_um"]["x"] < 4.0
    after(0.6)
    its = loop.shown()
    assert its["rms_peak_um"] == its["rms_um"]
    loop.tick(orbit=np.full(4, np.nan))  # the beam is gone: what it did last is still told
    assert loop.shown()["rms_peak_um"]["x"] == pytest.approx(its["rms_um"]["x"])
    loop.clock.advance(1.6)
    assert loop.shown()["rms_peak_um"] == {"x": None}


def test_the_peak_of_each_plane_is_its_own():
    clock, peaks = ManualClock(), Peaks("xy")
    for orbit in ([3e-6, 3e-6, 1e-6, 1e-6], [1e-6, 1e-6, 9e-6, np.nan]):
        clock.advance(0.3)
        peaks(record(clock, orbit=REFERENCE + np.array(orbit)))
    assert peaks.since(clock.monotonic()) == pytest.approx({"x": 3e-6, "y": 9e-6})


def test_an_old_orbit_and_a_loop_that_stands_still_are_told(loop):
    loop.tick()
    assert loop.shown()["orbit_age"] == 0.0
    loop.clock.advance(6.0)
    its = loop.shown()
    assert its["orbit_age"] == its["tick_age"] == 6.0 and not its["alive"]


def test_it_remembers_who_commanded_last_even_when_much_has_happened_since(loop):
    loop.tick()
    assert loop.shown()["command"] is None
    loop.statistics.happened("command", "close by anna@10.0.0.7")
    loop.statistics.happened("command", "gain by berta@host")
    loop.statistics.happened("command", "open by carl@host refused: not now")
    assert loop.shown()["command"] == {
        "did": "closed", "by": "anna@10.0.0.7", "time": loop.clock.wall()
    }  # fmt: skip
    for number in range(100):
        loop.statistics.happened("archive", str(number))
    its = loop.shown()
    assert its["command"]["by"] == "anna@10.0.0.7" and len(its["happenings"]) == 12
    loop.statistics.happened("command", "open by dora@host")
    assert loop.shown()["command"]["did"] == "opened"


def test_noise_floor_and_policy_are_those_of_refit_and_swap(loop):
    loop.tick()
    its = loop.shown()
    assert (its["floor_um"], its["floor_source"]) == (pytest.approx(0.2), "configuration")
    loop.clock.advance(2.0)
    figures = {"reading_noise": 0.25e-6}
    loop.statistics.refitted(
        RefitReport(1, 60.0, "periodic", 9, Decision.PROMOTED, "better", "b", "a", figures, 1.0)
    )
    loop.tick(policy="svd-2")
    its = loop.shown()
    assert (its["floor_um"], its["floor_source"]) == (pytest.approx(0.25), "refit")
    assert (its["policy"], its["policy_since"]) == ("svd-2", loop.clock.wall())
    assert its["refits"]["promoted"] == 1 and its["last_refit"]["reason"] == "better"
    loop.statistics.refitted(
        RefitReport(2, 61.0, "watch", 9, Decision.ROLLED_BACK, "worse", "b", "a", {}, 1.0)
    )
    assert loop.shown()["floor_um"] == pytest.approx(0.25)  # a roll-back brings none
