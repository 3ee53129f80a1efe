"""A slow channel without a stamp, or posted on change only, and why a value is not known."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from orbitfb.core.clock import ManualClock
from orbitfb.epics.auxiliary import AuxiliaryChannels
from orbitfb.epics.orbit.timekeeper import Timekeeper
from orbitfb.epics.records import EPICS_EPOCH, INVALID
from orbitfb.epics.settings import AuxiliarySettings
from orbitfb.safety.interlocks import InterlockSettings, stored_current


class Bench:
    def __init__(self, stale_after: float | None) -> None:
        self.clock = ManualClock(2.0e9)
        self.time = Timekeeper(self.clock, 1.0)
        context: Any = SimpleNamespace(library=None, telling=None)
        its = {"current": AuxiliarySettings(pv="I", stale_after=stale_after)}
        self.slow = AuxiliaryChannels(context, its)
        self.slow.group.connected[:] = True

    def post(
        self, value: float, stamped: bool = True, severity: int = 0, ahead: float = 0.0
    ) -> None:
        seconds = int(self.clock.wall() + ahead - EPICS_EPOCH) if stamped else 0
        self.slow._records[0] = (0, severity, seconds, 0, value)

    @property
    def value(self) -> float:
        return self.slow.read(self.time)[0]["current"]

    @property
    def why(self) -> str:
        return self.slow.read(self.time)[1].get("current", "")


@pytest.mark.parametrize("stamped", [True, False])
def test_without_a_limit_any_value_counts(stamped: bool):
    bench = Bench(None)
    bench.post(0.4, stamped)
    bench.clock.advance(1e6)
    assert bench.value == 0.4 and not bench.why


def test_with_a_limit_a_value_without_a_stamp_is_not_known_and_the_key_is_named():
    bench = Bench(10.0)
    bench.post(0.4, stamped=False)
    assert np.isnan(bench.value)
    assert "no time stamp" in bench.why and "epics.auxiliary.current.stale_after" in bench.why


def test_one_that_is_posted_on_change_only_is_told_as_such():
    bench = Bench(10.0)
    bench.post(0.4)
    assert bench.value == 0.4 and not bench.why
    bench.clock.advance(10.5)
    assert np.isnan(bench.value)
    assert "no new value for 10.5 s" in bench.why and "stale_after = 10 s" in bench.why
    told = stored_current({"current": bench.value}, InterlockSettings(), why={"current": bench.why})
    assert "epics.auxiliary.current.stale_after" in told.reason


@pytest.mark.parametrize("ahead", [0.0, 2.0, 10.0])
def test_a_value_stamped_in_the_future_grows_old_from_when_it_was_seen(ahead: float):
    """The clock of an IOC was ahead when the current was posted last; then it posts no more."""
    bench = Bench(10.0)
    bench.post(0.4, ahead=ahead)
    assert bench.value == 0.4
    bench.clock.advance(10.5)
    assert np.isnan(bench.value)
    assert "no new value for 10.5 s" in bench.why


def test_a_value_stamped_further_ahead_than_it_may_be_old_is_not_known():
    """It may have come long before it was looked at, as while no orbit came."""
    bench = Bench(10.0)
    bench.post(0.4, ahead=30.0)
    assert np.isnan(bench.value)
    assert "30.0 s in the future" in bench.why and "stale_after = 10 s" in bench.why
    bench.post(0.5)
    assert bench.value == 0.5 and not bench.why


def test_away_and_invalid_are_told_apart():
    bench = Bench(10.0)
    bench.post(0.4, severity=INVALID)
    assert "no valid value" in bench.why
    bench.slow.group.connected[:] = False
    assert "I is away" in bench.why
