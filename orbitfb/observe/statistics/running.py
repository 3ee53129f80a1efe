"""The running figures of the loop: a subscriber that counts, and snapshots for whoever asks."""

import math
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from orbitfb.core.gap import GapSight
from orbitfb.core.ports import Clock
from orbitfb.core.refit import Alarm, AlarmCause, Decision, RefitReport
from orbitfb.core.signals import Channels, LoopState, Mask, Orbit, Phases, TickRecord, Vector
from orbitfb.observe.statistics.averages import Averages, worst
from orbitfb.observe.statistics.devices import largest_error, nearest_limit
from orbitfb.observe.statistics.planes import PlaneErrors
from orbitfb.observe.statistics.snapshot import (
    LatencyFigures,
    LoopSnapshot,
    OrbitFigures,
    Rms,
    TickFigures,
)
from orbitfb.observe.statistics.tallies import Tallies
from orbitfb.observe.statistics.windows import (
    Histogram,
    Window,
    mean_and_deviation,
    percentiles,
    root_mean,
)

ORBIT_WINDOW = 10.0
"""Window of the orbit RMS and of the pace [s]."""

LATENCY_WINDOW = 60.0
"""Window of the latency percentiles [s]: long enough for a p99 at 10 Hz."""

TRUE_RMS = "true_orbit_rms"
"""Auxiliary channel in which a simulated ring tells its orbit RMS without BPM noise [m]."""
_ANSWERED = 1.0
"""Time from the closing of the loop within which the command for it is told [s]."""


class LoopStatistics:
    """Keep the running figures of the loop.

    Called with every record in the loop's thread it does some tens of microseconds of work;
    everything that can wait (percentiles, worst BPM, nearest limit) is done by `snapshot`, in the
    thread of whoever asks.

    Args:
        channels: Names behind the vectors.
        limit: Limit of |setpoint|, one for all or shape (m,) [A].
        clock: The loop's clock.
        counting: BPMs that are not masked by configuration, shape (n,); None: all.

    Attributes:
        enabled: Tells which BPMs operators have not disabled, shape (n,): the others are left out
            on purpose, and not invalid.
        unsaved: Tells whether settings of operators are in force that could not be saved yet.
    """

    def __init__(
        self,
        channels: Channels,
        limit: float | Vector,
        clock: Clock,
        counting: Mask | None = None,
    ) -> None:
        self._channels = channels
        self._limit = np.broadcast_to(
            np.asarray(limit, dtype=np.float64), (len(channels.correctors),)
        )
        self._clock = clock
        count = len(channels.bpms)
        all_bpms: Mask = np.ones(count, dtype=np.bool_)
        self.enabled: Callable[[], Mask] = lambda: all_bpms
        self.unsaved: Callable[[], bool] = lambda: False
        self._counting = all_bpms if counting is None else counting.copy()
        self._lock = threading.Lock()

        self._started = clock.monotonic()
        self._last: TickRecord | None = None
        self._last_orbit: Orbit | None = None
        self._last_monotonic = self._started
        self._last_wall = math.nan
        self._state_since = self._started
        self._entries: Counter[LoopState] = Counter()
        self._ticks = self._missed = self._held_back = self._limited = self._swaps = 0
        self._phase_sums = [0.0] * 5

        self._first_rms = math.nan
        self._observed = Window(ORBIT_WINDOW)
        self._true = Window(ORBIT_WINDOW)
        self._by_plane = PlaneErrors(channels.bpm_parts, ORBIT_WINDOW)
        self._now = self._true_now = math.nan
        self._stamp = self._received = math.nan
        self._intervals = Window(ORBIT_WINDOW)
        self._latencies = Window(LATENCY_WINDOW)
        self._histogram = Histogram()

        self._averages = Averages(channels, ORBIT_WINDOW)
        self._entry_reason = ""
        self._tallies = Tallies(clock)

    def __call__(self, record: TickRecord) -> None:
        """Take a record; called in the loop's thread."""
        with self._lock:
            self._ticks += 1
            self._missed += record.missed
            self._held_back += record.held_back
            self._limited += record.scale < 1.0
            self._count_phases(record.phases)
            self._note_changes(record)
            self._histogram.add(record.latency)
            self._take_reading(record)
            self._averages.add(record)
            self._last = record
            self._last_monotonic = self._clock.monotonic()
            self._last_wall = self._clock.wall()

    def refitted(self, report: RefitReport) -> None:
        """Take the report of a refit; called in the learner's thread."""
        with self._lock:
            self._tallies.refitted(report)

    def alarmed(self, alarm: Alarm) -> None:
        """Take an alarm of the learner; called in the learner's thread."""
        with self._lock:
            self._tallies.alarmed(alarm)

    def gap_seen(self, sight: GapSight) -> None:
        """Take a look at the gap; called in the watch's thread."""
        with self._lock:
            self._tallies.gap_seen(sight)

    def commanded(
        self,
        name: str,
        user: str,
        host: str,
        refusal: str = "",
        *,
        times: int = 1,
        told: bool = True,
    ) -> None:
        """Take a command of an operator; called from any thread.

        Args:
            name: Of the command.
            user: Who gave it.
            host: From where.
            refusal: Why it was refused; empty when it was carried out.
            times: How often.
            told: Whether people get a line about it.
        """
        with self._lock:
            last, since = self._last, self._clock.monotonic() - self._state_since
            idle = last is not None and last.state is LoopState.CLOSED and since > _ANSWERED
            idle = idle and name == "close"
            self._tallies.commanded(name, user, host, refusal, idle=idle, times=times, told=told)

    def happened(self, kind: str, text: str) -> None:
        """Note something that people want to know; called from any thread.

        Args:
            kind: One word, such as `archive`.
            text: What happened.
        """
        with self._lock:
            self._tallies.note(kind, text)

    def snapshot(self) -> LoopSnapshot:
        """Return the figures of this moment; called from any thread."""
        with self._lock:
            last, orbit = self._last, self._last_orbit
            entries, tallies = dict(self._entries), self._tallies
            refits, reasons = dict(tallies.refits), dict(tallies.reasons)
            observed, true = self._observed.copy(), self._true.copy()
            planes = self._by_plane.copy()
            now, true_now = self._now, self._true_now
            intervals, latencies = self._intervals.copy(), self._latencies.copy()
            buckets = self._histogram.cumulative()
            total, largest = self._histogram.total, self._histogram.largest
            ticks, missed, held_back = self._ticks, self._missed, self._held_back
            limited, swaps = self._limited, self._swaps
            phases = Phases(*self._phase_sums)
            monotonic = self._clock.monotonic()
            age, in_state = monotonic - self._last_monotonic, monotonic - self._state_since
            wall, stamp = self._last_wall, self._stamp
            last_refit, happenings = tallies.last_refit, tuple(tallies.happenings)
            gap, closing, commands = tallies.gap, tallies.closing, dict(tallies.commands)
            alarms = {cause: tallies.alarms[cause] for cause in AlarmCause}
            last_alarm, entry_reason = tallies.last_alarm, self._entry_reason
            errors, change, dither = self._averages.copy()
            noise = tallies.noise
        period, jitter = mean_and_deviation(intervals)
        p50, p99 = percentiles(latencies, 50.0, 99.0)
        error, worst_bpm = largest_error(last, self._channels)
        correctors = replace(
            nearest_limit(last, self._channels, self._limit),
            limited=limited,
            change=change,
            dither=dither,
        )
        reading = None if last is None else last.reading
        return LoopSnapshot(
            state=None if last is None else last.state,
            reason="" if last is None else last.reason,
            in_state=in_state,
            entries={state: entries.get(state, 0) for state in LoopState},
            duration=monotonic - self._started,
            orbit=OrbitFigures(
                first=self._first_rms,
                observed=Rms(now, root_mean(observed)),
                true=Rms(true_now, root_mean(true)),
                planes={plane: Rms(rms, root_mean(old)) for plane, (rms, old) in planes.items()},
                worst=error,
                worst_bpm=worst_bpm,
                masked=int(np.count_nonzero(~self._counting)),
                invalid=0
                if orbit is None
                else int(np.count_nonzero(self._counting & self.enabled() & ~orbit.valid)),
                bpms=len(self._channels.bpms),
                time=stamp,
                worst_bpms=worst(errors, self._channels.bpms, self._channels.bpm_planes),
            ),
            correctors=correctors,
            ticks=TickFigures(ticks, missed, held_back, age, wall, period, jitter, phases),
            latency=LatencyFigures(p50, p99, largest, buckets, total),
            auxiliary={} if reading is None else dict(reading.auxiliary),
            policy_id="" if last is None else last.policy_id,
            swaps=swaps,
            refits={decision: refits.get(decision, 0) for decision in Decision},
            last_refit=last_refit,
            alarms=alarms,
            last_alarm=last_alarm,
            happenings=happenings,
            gap=gap,
            entry_reason=entry_reason,
            closing=closing,
            commands=commands,
            noise=noise,
            refit_reasons=reasons,
        )

    def _count_phases(self, phases: Phases) -> None:
        sums = self._phase_sums
        sums[0] += phases.read
        sums[1] += phases.check
        sums[2] += phases.decide
        sums[3] += phases.limit
        sums[4] += phases.act

    def _note_changes(self, record: TickRecord) -> None:
        last = self._last
        if last is None or last.state is not record.state:
            self._entries[record.state] += 1
            self._state_since = self._clock.monotonic()
            because = f": {record.reason}" if record.reason else ""
            self._entry_reason = record.reason
            if last is None and record.state in (LoopState.CLOSED, LoopState.HELD):
                self._tallies.closed_by("start", "localhost")
            self._tallies.note("state", f"{record.state.value}{because}")
        if last is not None and last.policy_id != record.policy_id:
            self._swaps += 1
            self._tallies.note("policy", f"{record.policy_id} instead of {last.policy_id}")

    def _take_reading(self, record: TickRecord) -> None:
        reading = record.reading
        if reading is None:
            self._now = self._true_now = self._received = math.nan
            self._by_plane.forget_last()
            return
        stamp = reading.orbit.time
        mean_square = self._by_plane.add(reading.orbit, record.reference, stamp)
        self._now = math.sqrt(mean_square)
        if math.isnan(self._first_rms):
            self._first_rms = self._now
        self._observed.add(stamp, mean_square)
        self._true_now = reading.auxiliary.get(TRUE_RMS, math.nan)
        self._true.add(stamp, self._true_now**2)
        self._latencies.add(stamp, record.latency)
        # An interval that spans a missed orbit says nothing about the jitter.
        interval = math.nan if record.missed else reading.received - self._received
        self._intervals.add(stamp, interval)
        self._received = reading.received
        self._stamp = stamp
        self._last_orbit = reading.orbit
