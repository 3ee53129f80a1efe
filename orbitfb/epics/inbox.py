"""Where libca's threads leave a complete orbit and the loop takes it, with its readbacks.

Readbacks come before or after the reading that completes the orbit. When the IOC stamps the
readbacks of a tick like its orbit, the reader waits for them, at most `readback_wait`: then orbit
and readback are of one tick, and the readback belongs to the setpoints in force at that orbit. An
IOC that has not done so for some ticks is not waited for, until its readbacks are seen in step
again; its last known readbacks are taken instead.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.errors import NoOrbitError
from orbitfb.core.ports import Clock
from orbitfb.core.signals import Mask, Vector
from orbitfb.epics.orbit.assembler import Assembler
from orbitfb.epics.orbit.snapshot import Snapshot
from orbitfb.epics.orbit.timekeeper import Timekeeper
from orbitfb.epics.records import NANOSECONDS, stamps_of, usable
from orbitfb.epics.settings import EpicsSettings

MISSES_UNTIL_NOT_WAITED_FOR = 5


@dataclass(frozen=True, slots=True)
class Arrival:
    """An orbit, the moment in which it was complete, and its readbacks.

    Args:
        snapshot: The orbit.
        received: Monotonic clock [s].
        readbacks: Of the same tick, shape (m,); None while they are not there.
    """

    snapshot: Snapshot
    received: float
    readbacks: Vector | None = None


@dataclass(frozen=True, slots=True)
class Frame:
    """An orbit with its readbacks, shape (m,), in the units of the PVs.

    `behind` tells which of them are of before the orbit, shape (m,); None: none.
    """

    arrival: Arrival
    readback: Vector
    behind: Mask | None = None


class Inbox:
    """Keeps the newest orbit until the one reader takes it.

    Args:
        bpms: Assembler of the orbit.
        readbacks: Assembler of the readbacks.
        clock: Clock of the program.
        settings: Time limits.
        describe: Says what is missing when no orbit comes.
    """

    def __init__(
        self,
        bpms: Assembler,
        readbacks: Assembler,
        clock: Clock,
        settings: EpicsSettings,
        describe: Callable[[], str],
    ) -> None:
        self._bpms = bpms
        self._readback_assembler = readbacks
        self._clock = clock
        self._settings = settings
        self.time = Timekeeper(clock, settings.stale_after)
        """The clock of the stamps."""
        self._describe = describe
        self._wake = threading.Event()
        self._newest: Arrival | None = None
        self._readbacks: Snapshot | None = None
        self._taken = -1
        self._in_step = True
        self._misses = 0
        self._closed = False
        self._heard = clock.monotonic()

    @property
    def silence(self) -> float:
        """How long ago the last orbit was complete, or the inbox was made [s]."""
        newest = self._newest
        heard = self._heard if newest is None else newest.received
        return self._clock.monotonic() - heard

    def orbit_complete(self) -> None:
        """Take the orbit from the assembler; called on libca's thread."""
        orbit, known = self._bpms.snapshot(), self._readbacks
        readbacks = None
        if known is not None and self._matches(known, orbit):
            readbacks = known.values
            self._in_step, self._misses = True, 0
        self._newest = Arrival(orbit, self._clock.monotonic(), readbacks)
        self._wake.set()

    def readbacks_complete(self) -> None:
        """Take the readbacks from the assembler; called on libca's thread."""
        snapshot = self._readback_assembler.snapshot()
        self._readbacks = snapshot
        orbit = self._newest
        if orbit is None or not self._matches(snapshot, orbit.snapshot):
            return
        late = self._clock.monotonic() - orbit.received > self._settings.readback_wait
        if not late:
            self._in_step, self._misses = True, 0
        self._newest = replace(orbit, readbacks=snapshot.values)
        self._wake.set()

    def close(self) -> None:
        """Send a waiting reader away."""
        self._closed = True
        self._wake.set()

    def take(self, timeout: float) -> Frame:
        """Wait for the newest orbit that was not taken before.

        Args:
            timeout: How long to wait [s].

        Raises:
            NoOrbitError: None came in time, or only ones that are too old.
        """
        deadline = self._clock.monotonic() + timeout
        stale = ""
        while True:
            self._wake.clear()
            newest = self._newest
            if newest is not None and newest.snapshot.stamp != self._taken:
                self._taken = newest.snapshot.stamp
                stale = self._stale(newest.snapshot)
                if not stale:
                    self.time.follow(newest.snapshot.time)
                    return self._with_readbacks(newest)
            remaining = deadline - self._clock.monotonic()
            if remaining <= 0 or self._closed:
                self._accept_clock()
                raise NoOrbitError(
                    stale or f"no orbit for {self.silence:.2f} s: {self._describe()}"
                )
            self._wake.wait(remaining)

    def _accept_clock(self) -> None:
        """Begin anew with stamps that went back, if they are fresh: the clock was set."""
        for assembler in (self._bpms, self._readback_assembler):
            back = assembler.went_back
            if back is not None and abs(self.time.age(back)) <= self._settings.stale_after:
                assembler.begin_anew()

    def _stale(self, orbit: Snapshot) -> str:
        age = self.time.age(orbit.time)
        limit = self._settings.stale_after
        if age > limit:
            return f"orbit is {age:.1f} s old (limit {limit:g} s): overload, or clocks that differ"
        if age < -limit:
            return f"orbit is stamped {-age:.1f} s in the future: set the clocks"
        return ""

    def _with_readbacks(self, orbit: Arrival) -> Frame:
        limit = orbit.received + (self._settings.readback_wait if self._in_step else 0.0)
        while True:
            self._wake.clear()
            newest = self._newest
            if newest is not None and newest.snapshot is orbit.snapshot:
                orbit = newest  # perhaps with its readbacks by now
            if orbit.readbacks is not None:
                return Frame(orbit, orbit.readbacks)
            remaining = limit - self._clock.monotonic()
            if remaining <= 0 or newest is None or newest.snapshot is not orbit.snapshot:
                break
            self._wake.wait(remaining)
        if self._in_step:
            self._misses += 1
            self._in_step = self._misses < MISSES_UNTIL_NOT_WAITED_FOR
        assembler = self._readback_assembler
        known = assembler.connected & usable(assembler.records)
        window = round(self._settings.stamp_window * NANOSECONDS)
        behind = stamps_of(assembler.records) < orbit.snapshot.stamp - window
        return Frame(orbit, np.where(known, assembler.records["value"], np.nan), behind)

    def _matches(self, readbacks: Snapshot, orbit: Snapshot) -> bool:
        apart = abs(readbacks.time - orbit.time)
        return readbacks.stamp == orbit.stamp or apart <= self._settings.stamp_window
