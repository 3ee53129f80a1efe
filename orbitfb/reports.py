"""What happens beside the loop goes to the figures, to the events and to the log."""

import structlog

from orbitfb.core.errors import ArchiveError, EstimationError
from orbitfb.core.gap import GapSight
from orbitfb.core.refit import Alarm, RefitReport
from orbitfb.loop.excitation import Excitation, Progress
from orbitfb.observe.event_log import EventLog
from orbitfb.observe.statistics import LoopStatistics

_log = structlog.stdlib.get_logger("orbitfb.service")


class Reports:
    """Takes the reports of the service's threads.

    Args:
        statistics: Figures and the last events, for metrics and display.
        events: The log of events.
    """

    def __init__(self, statistics: LoopStatistics, events: EventLog) -> None:
        self._statistics, self._events = statistics, events

    def gap_seen(self, sight: GapSight) -> None:
        """Take a look at the gap between model and machine."""
        self._statistics.gap_seen(sight)
        self._events.gap_seen(sight)

    def look_failed(self, error: EstimationError) -> None:
        """Take why there was no look at the gap."""
        _log.warning("gap_watch_failed", problem=str(error))

    def refitted(self, report: RefitReport) -> None:
        """Take what a refit came to."""
        self._statistics.refitted(report)
        self._events.refitted(report)

    def alarmed(self, alarm: Alarm) -> None:
        """Take that the running model no longer explains the orbits."""
        self._statistics.alarmed(alarm)
        self._events.alarmed(alarm)

    def archive_failed(self, error: ArchiveError) -> None:
        """Take why the archive cannot write."""
        _log.error("archive_failed", problem=str(error))
        self._statistics.happened("archive", str(error))

    def ring_died(self, failure: str) -> None:
        """Take why the simulated ring of our own died."""
        self._statistics.happened("ring", failure)


def say_excitation(excitation: Excitation) -> None:
    """Log how far a planned excitation came."""
    progress = excitation.progress
    say = _log.info if progress is Progress.DONE else _log.warning
    say("excitation", progress=progress, ticks=excitation.rows)
