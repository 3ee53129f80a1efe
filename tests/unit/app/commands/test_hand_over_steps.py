"""Handing our reference to a fast feedback: steps, what is read back, when it ends."""

import math

import numpy as np
import pytest

from orbitfb.app.commands.hand_over import HANDS_OVER, OFF, STOPPED, HandOver
from orbitfb.core.errors import ControlError, MachineError, WriteError

STEP, TOLERANCE = 10e-6, 1e-8
WHICH = np.array([True, True, True, False])


class Fast:
    """A fast feedback that takes what it is given."""

    which = WHICH

    def __init__(self):
        self.values, self.puts, self.away = np.zeros(3), [], ""
        self.takes = True

    def ask(self):
        if self.away:
            raise MachineError(self.away)
        return self.values.copy()

    def put(self, values):
        if self.away:
            raise WriteError(self.away)
        self.puts.append(values.copy())
        if self.takes:
            self.values = values.copy()


class Bench:
    def __init__(self, wanted=(25e-6, -5e-6, 0.0, 99e-6)):
        self.fast, self.wanted, self.open, self.lost = Fast(), np.array(wanted), "", ""
        self.its = HandOver(
            self.fast, lambda: self.wanted, lambda: self.open, lambda: self.lost, STEP, TOLERANCE
        )

    def run(self, steps):
        for _ in range(steps):
            self.its.step()


def test_it_goes_there_in_limited_steps_and_stays():
    bench = Bench()
    bench.its.begin()
    assert bench.its.sight.state == HANDS_OVER
    assert bench.its.sight.left == pytest.approx(25e-6)
    bench.run(10)
    moves = np.diff(np.vstack([np.zeros(3), *bench.fast.puts]), axis=0)
    assert np.abs(moves).max() <= STEP * (1 + 1e-12) and len(bench.fast.puts) == 3
    np.testing.assert_allclose(bench.fast.values, bench.wanted[WHICH], atol=1e-15)
    assert bench.its.sight.left == pytest.approx(0.0, abs=1e-15)
    bench.wanted = bench.wanted + 4e-6
    bench.run(2)
    np.testing.assert_allclose(bench.fast.values, bench.wanted[WHICH], atol=1e-15)


def test_nothing_is_put_before_it_begins_or_after_it_ends():
    bench = Bench()
    bench.run(3)
    bench.its.begin()
    bench.run(1)
    bench.its.end()
    bench.run(3)
    assert len(bench.fast.puts) == 1 and bench.its.sight.state == OFF
    assert math.isnan(bench.its.sight.left)


@pytest.mark.parametrize("why", ["puts", "foreign"])
def test_what_is_not_as_it_was_put_is_let_go(why):
    bench = Bench()
    bench.its.begin()
    bench.fast.takes = why != "puts"
    bench.run(1)
    if why == "foreign":
        bench.fast.values[1] += 3e-6
    bench.run(1)
    sight = bench.its.sight
    assert sight.state == STOPPED and "is not what was put" in sight.reason
    count = len(bench.fast.puts)
    bench.run(5)
    assert len(bench.fast.puts) == count
    bench.fast.takes = True
    bench.its.begin()
    bench.run(5)
    np.testing.assert_allclose(bench.fast.values, bench.wanted[WHICH], atol=1e-15)


def test_rounding_is_no_other_reference():
    bench = Bench()
    put = bench.fast.put
    bench.fast.put = lambda values: put(np.round(values * 1e9) / 1e9)
    bench.wanted[:] = 12.3456e-6
    bench.its.begin()
    bench.run(10)
    assert bench.its.sight.state == HANDS_OVER and len(bench.fast.puts) == 2


def test_it_ends_with_the_fast_feedback_and_waits_for_what_is_away():
    bench = Bench()
    bench.open = "the fast feedback is open"
    assert not bench.its.applies
    with pytest.raises(ControlError, match="the fast feedback is open"):
        bench.its.begin()
    bench.open = ""
    bench.its.begin()
    bench.fast.away = "1 PV is away"
    bench.run(2)
    assert bench.its.sight.state == HANDS_OVER and bench.its.sight.reason == "1 PV is away"
    bench.fast.away, bench.lost = "", "the lease is lost"
    bench.run(2)
    assert not bench.fast.puts and bench.its.sight.reason == "the lease is lost"
    bench.lost = ""
    bench.run(1)
    assert len(bench.fast.puts) == 1 and bench.its.sight.reason == ""
    bench.open = "the fast feedback is open"
    bench.run(1)
    assert bench.its.sight.state == OFF and bench.its.sight.reason == bench.open
    bench.open = ""
    bench.run(2)
    assert len(bench.fast.puts) == 1  # not again by itself


def test_a_reference_that_cannot_be_read_is_told_before_anything_moves():
    bench = Bench()
    bench.fast.away = "180 of 180 PVs did not answer"
    with pytest.raises(ControlError, match="not handed over: 180 of 180"):
        bench.its.begin()
    bench.run(1)
    assert bench.its.sight.state == OFF and not bench.fast.puts
