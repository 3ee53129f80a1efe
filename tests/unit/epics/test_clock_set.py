"""Somebody sets a clock, ours or that of the IOC: what is fresh stays fresh, old stays old."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orbitfb.core.errors import NoOrbitError
from orbitfb.epics.auxiliary import AuxiliaryChannels
from orbitfb.epics.inbox import Inbox
from orbitfb.epics.orbit.assembler import Assembler
from orbitfb.epics.orbit.timekeeper import Timekeeper
from orbitfb.epics.records import EPICS_EPOCH
from orbitfb.epics.settings import AuxiliarySettings, EpicsSettings

HOUR = 3600.0


class Clock:
    """Two clocks, of which the wall clock can be set."""

    def __init__(self) -> None:
        self.time, self.set_by = 5000.0, 2.0e9

    def monotonic(self) -> float:
        return self.time

    def wall(self) -> float:
        return self.time + self.set_by


class Bench:
    """An IOC with three BPMs and a slow channel, whose clock can be set too."""

    def __init__(self) -> None:
        self.clock = Clock()
        self.ioc = self.clock.set_by
        self.bpms = Assembler(3)
        for index in range(3):
            self.bpms.set_connected(index, True)
        settings = EpicsSettings(readback_wait=0.0)
        self.inbox = Inbox(self.bpms, Assembler(1), self.clock, settings, lambda: "described")
        slow = {"current": AuxiliarySettings(pv="I", stale_after=10.0)}
        context: Any = SimpleNamespace(library=None, telling=None)
        self.slow = AuxiliaryChannels(context, slow)
        self.slow.group.connected[:] = True
        self.tick()

    def stamp(self, late: float = 0.0) -> tuple[int, int]:
        seconds, part = divmod(self.clock.time + self.ioc - late - EPICS_EPOCH, 1.0)
        return int(seconds), round(part * 1e9)

    def tick(self, late: float = 0.0, slow: bool = False) -> float | None:
        """Pass a tick; the orbit that came of it, or None."""
        self.clock.time += 0.1
        for index in range(3):
            self.bpms.records[index] = (0, 0, *self.stamp(late), self.clock.time)
            if self.bpms.arrived():
                self.inbox.orbit_complete()
        if slow:
            self.slow._records[0] = (0, 0, *self.stamp(late), 0.4)
        try:
            orbit = float(self.inbox.take(0.0).arrival.snapshot.values[0])
            self.current()
            return orbit
        except NoOrbitError as error:
            self.told = str(error)
            return None

    def current(self) -> float:
        return self.slow.read(self.inbox.time)[0]["current"]

    def ticks(self, count: int) -> list[bool]:
        return [self.tick() is not None for _ in range(count)]


@pytest.mark.parametrize("step", [HOUR, -HOUR, 0.3, -0.3, 30.0])
def test_our_clock_is_set_and_the_loop_goes_on(step: float):
    bench = Bench()
    bench.tick(slow=True)
    assert bench.current() == 0.4
    bench.clock.set_by += step
    assert bench.ticks(20) == [True] * 20
    assert bench.current() == 0.4
    bench.clock.time += 9.0
    assert np.isnan(bench.current())  # it grows old all the same


@pytest.mark.parametrize("step", [HOUR, -HOUR, 0.35, -0.35])
def test_both_clocks_are_set_and_the_loop_goes_on(step: float):
    """As on a computer that has both; at most three ticks are lost."""
    bench = Bench()
    bench.tick(slow=True)
    bench.clock.set_by += step
    bench.ioc += step
    came = bench.ticks(20)
    assert came[3:] == [True] * 17
    assert bench.current() == 0.4  # not posted since
    bench.tick(slow=True)
    assert bench.current() == 0.4
    assert abs(bench.inbox.time.now() - bench.clock.wall()) < 1e-6 or abs(step) < 1.0


@pytest.mark.parametrize("step", [HOUR, -HOUR])
def test_the_clock_of_the_ioc_alone_holds_until_it_is_right(step: float):
    """Its orbits might be old: nobody can tell."""
    bench = Bench()
    bench.ioc += step
    assert not any(bench.ticks(20))
    bench.ioc -= step
    assert all(bench.ticks(20)[3:])


@pytest.mark.parametrize("step", [0.0, HOUR, -HOUR])
def test_an_orbit_that_is_late_is_old_whatever_the_clocks_say(step: float):
    bench = Bench()
    bench.clock.set_by += step
    bench.ticks(3)
    assert bench.tick(late=0.5) is None or step == 0.0  # older than the last: never again
    for _ in range(10):
        assert bench.tick(late=2.0) is None


def test_what_is_delivered_again_is_never_taken_for_a_clock_that_was_set():
    bench = Bench()
    bench.ticks(100)
    for late in np.arange(10.0, 2.0, -0.05):  # a gateway that empties its store
        assert bench.tick(float(late)) is None
    assert "described" in bench.told or "old" in bench.told


@given(st.lists(st.floats(-1e5, 1e5), max_size=10), st.floats(-1e5, 1e5))
def test_nothing_that_is_old_by_both_clocks_is_young(steps: list[float], late: float):
    clock = Clock()
    keeper = Timekeeper(clock, 1.0)
    for step in steps:
        clock.time += 0.1
        clock.set_by += step
        keeper.follow(keeper.now())
    stamp = keeper.now() - late
    young = abs(keeper.age(stamp)) <= 1.0
    assert young == (abs(late) <= 1.0 or abs(clock.wall() - stamp) <= 1.0)
