"""Statistics on a clock that is moved by hand."""

import pytest
from observe_records import channels

from orbitfb.core.clock import ManualClock
from orbitfb.observe.statistics.running import LoopStatistics


@pytest.fixture
def clock():
    return ManualClock()


@pytest.fixture
def statistics(clock):
    return LoopStatistics(channels(), 18.0, clock)
