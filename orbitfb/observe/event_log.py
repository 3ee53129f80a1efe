"""What the log says about the loop: changes of state and policy, refits, bursts of trouble."""

import math

import numpy as np
import structlog

from orbitfb.core.gap import GapSight
from orbitfb.core.ports import Clock
from orbitfb.core.refit import Alarm, Decision, RefitReport
from orbitfb.core.signals import Channels, LoopState, Mask, TickRecord

SEVERITY = {
    LoopState.OPEN: "info",
    LoopState.SHADOW: "info",
    LoopState.CLOSED: "info",
    LoopState.HELD: "warning",
    LoopState.TRIPPED: "error",
    LoopState.FAULT: "critical",
}

MOST_NAMES = 20
"""Names that one line lists at most."""


class EventLog:
    """Log what happens to the loop: a subscriber, and the listener of the learner.

    What can come with every tick (missed orbits, shortened changes, BPMs that come and go) is
    told at once, then at most once per quiet time, with the count of what happened in between.

    Args:
        channels: Names behind the vectors.
        clock: The loop's clock.
        quiet_time: Least time between two lines about the same trouble [s].
        counting: BPMs that are not masked by configuration, shape (n,); None: all. Of the others
            nothing is told.
    """

    def __init__(
        self,
        channels: Channels,
        clock: Clock,
        quiet_time: float = 10.0,
        counting: Mask | None = None,
    ) -> None:
        self._log = structlog.stdlib.get_logger("orbitfb.loop")
        self._learner_log = structlog.stdlib.get_logger("orbitfb.learn")
        self._gap_log = structlog.stdlib.get_logger("orbitfb.diagnose")
        self._gap_resolved = False
        self._channels = channels
        self._state: LoopState | None = None
        self._reason = ""
        self._policy_id = ""
        self._valid: Mask = np.ones(len(channels.bpms), dtype=np.bool_)
        self._ignored: Mask = ~(self._valid if counting is None else counting)
        self._missed = _Burst(clock, quiet_time)
        self._limited = _Burst(clock, quiet_time)
        self._smallest_scale = 1.0
        self._masked = _Burst(clock, quiet_time)
        self._reasons = _Burst(clock, quiet_time)

    def __call__(self, record: TickRecord) -> None:
        """Take a record; called in the loop's thread."""
        if record.state is not self._state:
            self._log_state(record)
        elif record.reason != self._reason and self._reasons.count(1):
            self._log.info(
                "loop_reason_changed",
                tick=record.tick,
                state=record.state,
                reason=record.reason,
                changes=self._reasons.take(),
            )
            self._reason = record.reason
        if record.policy_id != self._policy_id:
            self._log.info(
                "policy_swapped" if self._policy_id else "policy_in_force",
                tick=record.tick,
                policy=record.policy_id,
                before=self._policy_id or None,
            )
            self._policy_id = record.policy_id
        if self._missed.count(record.missed):
            self._log.warning("orbits_missed", tick=record.tick, count=self._missed.take())
        self._smallest_scale = min(self._smallest_scale, record.scale)
        if self._limited.count(record.scale < 1.0):
            self._log.info(
                "change_limited",
                tick=record.tick,
                smallest_scale=self._smallest_scale,
                count=self._limited.take(),
            )
            self._smallest_scale = 1.0
        if record.reading is not None:
            self._watch_bpms(record.tick, record.reading.orbit.valid)

    def refitted(self, report: RefitReport) -> None:
        """Take the report of a refit; called in the learner's thread."""
        rolled_back = report.decision is Decision.ROLLED_BACK
        tell = self._learner_log.warning if rolled_back else self._learner_log.info
        tell(
            "refit_judged",
            number=report.number,
            trigger=report.trigger,
            decision=report.decision,
            reason=report.reason,
            candidate=report.policy_id,
            incumbent=report.incumbent_id,
            rows=report.rows,
            duration=report.duration,
            stage=report.stage,
            figures=dict(report.figures),
        )

    def alarmed(self, alarm: Alarm) -> None:
        """Take an alarm of the learner; called in the learner's thread."""
        self._learner_log.warning(
            "model_degraded",
            tick=alarm.tick,
            cause=alarm.cause,
            delay=alarm.delay,
            statistic=alarm.statistic,
            threshold=alarm.threshold,
        )

    def gap_seen(self, sight: GapSight) -> None:
        """Take a look at the gap; called in the watch's thread."""
        if sight.resolved == self._gap_resolved:
            return
        self._gap_resolved = sight.resolved
        tell = self._gap_log.warning if sight.resolved else self._gap_log.info
        tell(
            "gap_resolved" if sight.resolved else "gap_gone",
            nats_per_tick=sight.nats,
            low=sight.low,
            high=sight.high,
            ticks=sight.ticks,
            suspected=sight.effect or None,
            places=list(sight.places[:MOST_NAMES]),
            probability=sight.probability,
        )

    def _log_state(self, record: TickRecord) -> None:
        tell = getattr(self._log, SEVERITY[record.state])
        tell(
            "loop_state_changed",
            tick=record.tick,
            state=record.state,
            before=self._state,
            reason=record.reason,
        )
        self._state, self._reason = record.state, record.reason

    def _watch_bpms(self, tick: int, valid: Mask) -> None:
        valid = valid | self._ignored
        changed = not np.array_equal(valid, self._valid)
        if not self._masked.count(changed):
            return
        self._masked.take()
        if not changed:  # what changed in the quiet time is as it was told
            return
        names = [self._channels.bpms[index] for index in np.flatnonzero(~valid)]
        tell = self._log.warning if names else self._log.info
        tell(
            "bpm_mask_changed",
            tick=tick,
            masked=len(names),
            bpms=names[:MOST_NAMES],
        )
        self._valid = valid.copy()


class _Burst:
    """Count what comes in bursts and say when it is time to tell.

    Args:
        clock: The loop's clock.
        quiet_time: Least time between two tellings [s].
    """

    def __init__(self, clock: Clock, quiet_time: float) -> None:
        self._clock = clock
        self._quiet_time = quiet_time
        self._told = -math.inf
        self._count = 0

    def count(self, more: int) -> bool:
        """Add to the count; True when there is something to tell and it is time."""
        if more:
            self._count += int(more)
        elif not self._count:
            return False
        return self._clock.monotonic() - self._told >= self._quiet_time

    def take(self) -> int:
        """Return the count and begin anew."""
        self._told = self._clock.monotonic()
        count, self._count = self._count, 0
        return count
