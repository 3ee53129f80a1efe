"""The newest orbit is taken once, with readbacks of its own tick where there are any."""

import numpy as np
import pytest

from orbitfb.core.clock import ManualClock
from orbitfb.core.errors import NoOrbitError
from orbitfb.epics.inbox import MISSES_UNTIL_NOT_WAITED_FOR, Inbox
from orbitfb.epics.orbit.assembler import Assembler
from orbitfb.epics.records import EPICS_EPOCH
from orbitfb.epics.settings import EpicsSettings


class Bench:
    """An inbox with two BPMs and two readbacks; time stands still unless it is moved."""

    def __init__(self, **settings: float) -> None:
        self.clock = ManualClock(2.0e9)
        self.bpms, self.readbacks = Assembler(2), Assembler(2)
        for index in range(2):
            self.bpms.set_connected(index, True)
            self.readbacks.set_connected(index, True)
        self.inbox = Inbox(
            self.bpms,
            self.readbacks,
            self.clock,
            EpicsSettings(**({"readback_wait": 0.0} | settings)),
            lambda: "described",
        )

    def orbit(self, value: float, age: float = 0.0) -> None:
        self._send(self.bpms, value, age, self.inbox.orbit_complete)

    def readback(self, value: float, age: float = 0.0) -> None:
        self._send(self.readbacks, value, age, self.inbox.readbacks_complete)

    def _send(self, assembler, value, age, complete) -> None:
        seconds, part = divmod(self.clock.wall() - age - EPICS_EPOCH, 1.0)
        for index in range(2):
            assembler.records[index] = (0, 0, int(seconds), round(part * 1e9), value)
            if assembler.arrived():
                complete()


def test_an_orbit_is_taken_once():
    bench = Bench()
    bench.orbit(1.0)
    frame = bench.inbox.take(0.0)
    np.testing.assert_array_equal(frame.arrival.snapshot.values, [1.0, 1.0])
    assert frame.arrival.snapshot.time == pytest.approx(bench.clock.wall(), abs=1e-6)
    with pytest.raises(NoOrbitError, match=r"no orbit for 0.00 s: described"):
        bench.inbox.take(0.0)


def test_readbacks_of_before_the_orbit_are_told():
    bench = Bench()
    bench.clock.advance(1.0)
    bench.readback(0.5, age=0.1)
    bench.orbit(1.0)
    frame = bench.inbox.take(0.0)
    assert frame.behind is not None and frame.behind.all()
    bench.clock.advance(0.1)
    bench.readback(0.6)
    bench.orbit(1.0)
    assert bench.inbox.take(0.0).behind is None


def test_the_newest_of_several_is_taken():
    bench = Bench()
    for value in (1.0, 2.0, 3.0):
        bench.clock.advance(0.1)
        bench.orbit(value)
    assert bench.inbox.take(0.0).arrival.snapshot.values[0] == 3.0
    with pytest.raises(NoOrbitError):
        bench.inbox.take(0.0)


def test_an_old_orbit_is_refused_and_its_age_told():
    bench = Bench(stale_after=1.0)
    bench.orbit(1.0, age=1.8)
    with pytest.raises(NoOrbitError, match=r"orbit is 1\.8 s old \(limit 1 s\)"):
        bench.inbox.take(0.0)
    bench.clock.advance(0.1)
    bench.orbit(2.0, age=0.9)
    assert bench.inbox.take(0.0).arrival.snapshot.values[0] == 2.0


def test_an_orbit_from_the_future_is_refused():
    bench = Bench(stale_after=1.0)
    bench.orbit(1.0, age=-5.0)
    with pytest.raises(NoOrbitError, match=r"5\.0 s in the future"):
        bench.inbox.take(0.0)


def test_readbacks_of_the_same_stamp_go_with_the_orbit():
    bench = Bench()
    bench.orbit(1.0)
    bench.readback(11.0)
    bench.clock.advance(0.1)
    bench.orbit(2.0)
    bench.readback(12.0)
    np.testing.assert_array_equal(bench.inbox.take(0.0).readback, [12.0, 12.0])


def test_last_known_readbacks_go_with_the_orbit_when_none_of_its_own_come():
    bench = Bench()
    bench.readback(11.0)
    bench.clock.advance(0.1)
    bench.readbacks.set_connected(1, False)
    bench.orbit(1.0)
    np.testing.assert_array_equal(bench.inbox.take(0.0).readback, [11.0, np.nan])


def test_a_machine_without_readbacks_in_step_is_soon_not_waited_for():
    bench = Bench(readback_wait=0.01)
    waits = []
    bench.inbox._wake.wait = lambda seconds: (waits.append(seconds), bench.clock.advance(seconds))
    for tick in range(MISSES_UNTIL_NOT_WAITED_FOR + 3):
        bench.clock.advance(0.1)
        bench.orbit(float(tick))
        bench.inbox.take(0.0)
    assert len(waits) == MISSES_UNTIL_NOT_WAITED_FOR
    bench.clock.advance(0.1)
    bench.orbit(1.0)
    bench.readback(1.0)  # in step again
    bench.inbox.take(0.0)
    bench.clock.advance(0.1)
    bench.orbit(1.0)
    bench.inbox.take(0.0)
    assert len(waits) == MISSES_UNTIL_NOT_WAITED_FOR + 1


def test_a_reader_is_sent_away_when_the_machine_closes():
    bench = Bench()
    bench.inbox.close()
    with pytest.raises(NoOrbitError):
        bench.inbox.take(1.0e6)


def test_silence_counts_from_the_last_complete_orbit():
    bench = Bench()
    bench.clock.advance(3.0)
    assert bench.inbox.silence == pytest.approx(3.0)
    bench.orbit(1.0)
    bench.clock.advance(0.5)
    assert bench.inbox.silence == pytest.approx(0.5)


def test_readbacks_that_come_before_their_orbit_stay_with_it():
    """Also when those of the next tick are there before the reader comes."""
    bench = Bench(readback_wait=1.0)
    bench.readback(5.0)
    bench.orbit(1.0)
    bench.clock.advance(0.1)
    bench.readback(6.0)
    frame = bench.inbox.take(0.0)
    assert frame.arrival.snapshot.values[0] == 1.0
    np.testing.assert_array_equal(frame.readback, [5.0, 5.0])
