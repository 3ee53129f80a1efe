"""What sees every tick of a service: figures, events, history, archive, post-mortems."""

from contextlib import ExitStack
from dataclasses import dataclass

import structlog

from orbitfb.app.commands.preview import Latest
from orbitfb.app.service.access import RingAccess
from orbitfb.app.service.policies import Policies
from orbitfb.app.service.reports import Reports, postmortems
from orbitfb.config.tree import AppConfig
from orbitfb.core.ports import Clock, Subscriber
from orbitfb.core.signals import Channels
from orbitfb.history.archive import ArchiveWriter
from orbitfb.history.buffer import History
from orbitfb.observe.clock_watch import ClockWatch
from orbitfb.observe.event_log import EventLog
from orbitfb.observe.server_news import ServerNews
from orbitfb.observe.statistics.running import LoopStatistics
from orbitfb.policies.stability import is_unstable, warning_of
from orbitfb.policies.trips import TripNotes
from orbitfb.postmortem.recorder import PostMortemRecorder

_log = structlog.stdlib.get_logger("orbitfb.service")


@dataclass(frozen=True, slots=True)
class Observers:
    """What sees every tick.

    Args:
        statistics: Figures of the loop.
        reports: Takes what happens beside the loop.
        history: The last transitions.
        archive: All of them.
        recorders: Of post-mortems; empty: there is none.
        latest: The last orbit.
        clocks: Counts how often a clock was set.
        others: Whoever else sees every tick.
    """

    statistics: LoopStatistics
    reports: Reports
    history: History
    archive: ArchiveWriter
    recorders: tuple[PostMortemRecorder, ...]
    latest: Latest
    clocks: ClockWatch
    others: tuple[Subscriber, ...]

    @property
    def all(self) -> tuple[Subscriber, ...]:
        """Who sees every tick, in this order."""
        return (self.history, self.archive, self.statistics, *self.others)


def make_observers(
    config: AppConfig,
    ioc: str,
    channels: Channels,
    access: RingAccess,
    policies: Policies,
    clock: Clock,
    stack: ExitStack,
) -> Observers:
    """Make what sees every tick.

    Args:
        config: The configuration.
        ioc: Where the ring is, as the command line calls it.
        channels: Of the loop.
        access: The ring as the service reaches it.
        policies: What there is to correct with.
        clock: The time.
        stack: Closes what is opened here, in reverse order.
    """
    first = policies.first
    statistics = LoopStatistics(channels, access.bounds().largest, clock, access.counting)
    if warning := warning_of(first):
        word = "policy_unstable" if is_unstable(warning) else "policy_near_its_limit"
        _log.warning(word, policy=first.policy_id, problem=warning)
        statistics.happened("policy", f"{first.policy_id} is {warning}")
    events = EventLog(channels, clock, config.observe.logs.quiet_time, access.counting)
    reports = Reports(statistics, events)
    archive = ArchiveWriter(
        config.data_directory / "archive",
        channels,
        config.history.archive,
        reports.archive_failed,
        on_resumed=reports.archive_resumed,
    )
    stack.callback(archive.close)
    recorders = postmortems(config, ioc, channels, access.counting, reports, stack)
    latest, clocks = Latest(), ClockWatch(clock, reports.clock_set)
    trips = TripNotes(policies.store, config.interlocks)
    stack.callback(trips.close)
    news = ServerNews(lambda: access.machine.doubled, reports.servers_told)
    history = History(channels, config.history.capacity)
    others = (events, latest, clocks, trips, news, *recorders)
    return Observers(statistics, reports, history, archive, recorders, latest, clocks, others)
