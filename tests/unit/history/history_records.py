"""Records whose every number is known from the tick, so that a torn row shows."""

from collections import deque

import numpy as np

from orbitfb.core.clock import ManualClock
from orbitfb.core.signals import (
    Channels,
    LoopState,
    Orbit,
    Phases,
    Reading,
    TickRecord,
)
from orbitfb.history.archive import ArchiveSettings
from orbitfb.history.buffer import History
from orbitfb.history.recorder import Recorder

START = 1.7e9
PHASES = Phases(0.0, 0.0, 0.0, 0.0, 0.0)


def make_channels(bpms=5, correctors=4, prefix=""):
    orbit = tuple(f"{prefix}BPM{i}" for i in range(bpms))
    magnets = tuple(f"{prefix}COR{i}" for i in range(correctors))
    return Channels("x", orbit, magnets, orbit, magnets, magnets)


def make_record(tick, bpms=5, correctors=4, **changes):
    """A record of a closed loop at 10 Hz; element j of vector i is 1000 tick + 100 i + j."""

    def vector(number, size):
        return 1000.0 * tick + 100.0 * number + np.arange(size)

    time = START + 0.1 * tick
    reading = Reading(
        orbit=Orbit(vector(0, bpms), np.ones(bpms, dtype=bool), time),
        readback=vector(1, correctors),
        auxiliary={"current": 0.4 + 1e-6 * tick, "rf_frequency": 5e8 + tick},
        received=0.1 * tick,
    )
    values = {
        "tick": tick,
        "state": LoopState.CLOSED,
        "reason": "",
        "reading": reading,
        "reference": vector(2, bpms),
        "setpoints": vector(3, correctors),
        "requested": vector(4, correctors),
        "dither": vector(5, correctors),
        "applied": vector(6, correctors),
        "scale": 1.0,
        "written": time + 0.01,
        "policy_id": f"svd-{tick // 10}",
        "phases": PHASES,
        "latency": 0.001,
        "missed": 0,
    }
    return TickRecord(**{**values, **changes})


def check_row(transitions, row):
    """See that a transition comes from one tick and the one after it, whole."""
    tick = transitions.tick[row]
    this, after = make_record(int(tick)), make_record(int(tick) + 1)
    for name in ("reference", "setpoints", "requested", "dither", "applied"):
        np.testing.assert_array_equal(getattr(transitions, name)[row], getattr(this, name))
    np.testing.assert_array_equal(transitions.orbit[row], this.reading.orbit.position)
    np.testing.assert_array_equal(transitions.next_orbit[row], after.reading.orbit.position)
    np.testing.assert_array_equal(transitions.readback[row], this.reading.readback)
    assert transitions.time[row] == this.reading.orbit.time
    assert transitions.next_time[row] == after.reading.orbit.time
    assert transitions.written[row] == this.written
    assert transitions.policy_id[row] == this.policy_id
    assert transitions.auxiliary["current"][row] == this.reading.auxiliary["current"]


def assert_same(first, second):
    """See that two sets of transitions are equal in every column, NaN for NaN."""
    for name in first.__slots__:
        if name != "auxiliary":
            np.testing.assert_array_equal(getattr(first, name), getattr(second, name), name)
    assert set(first.auxiliary) == set(second.auxiliary)
    for name, column in first.auxiliary.items():
        np.testing.assert_array_equal(column, second.auxiliary[name], name)


def eventful_run():
    """Sixty ticks in which everything happens that makes a transition unusable."""
    changes = {
        7: {"reading": None, "written": np.nan, "state": LoopState.HELD},
        13: {"missed": 2},
        20: {"written": np.nan, "state": LoopState.SHADOW},
        30: {"written": START + 3.15},
        41: {"policy_id": "golden µ"},
    }
    records = [make_record(tick, **changes.get(tick, {})) for tick in range(60)]
    del records[50]
    return records


MANY = ArchiveSettings(segment_megabytes=1.0, compress=False)


class Archive:
    """A recorder without its thread."""

    def __init__(self, directory, settings=MANY, channels=None, clock=None):
        self.directory = directory
        self.channels = channels or make_channels()
        self.clock = clock or ManualClock()
        self.recorder = Recorder(directory, self.channels, settings, self.clock)

    def write(self, records):
        queue = deque(records)
        while self.recorder.write(queue):
            pass

    def tidy(self):
        while self.recorder.tidy():
            pass

    def segments(self):
        return sorted(self.directory.glob("*.h5"))


def buffered(records):
    history = History(make_channels(), 10_000)
    for record in records:
        history(record)
    return history.snapshot()
