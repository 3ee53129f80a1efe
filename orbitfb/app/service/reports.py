"""What happens beside the loop goes to the figures, to the events and to the log."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import structlog

from orbitfb.config.text import to_toml
from orbitfb.config.tree import AppConfig
from orbitfb.core.clock import SystemClock
from orbitfb.core.errors import ArchiveError, EstimationError
from orbitfb.core.gap import GapSight
from orbitfb.core.refit import Alarm, RefitReport
from orbitfb.core.signals import Channels, Mask
from orbitfb.diagnose.live.process import GapProcess
from orbitfb.diagnose.live.watch import GapWatch
from orbitfb.effects.build import layout_of
from orbitfb.epics.machine import EpicsMachine
from orbitfb.history.buffer import History
from orbitfb.loop.excitation.dither import Dither
from orbitfb.loop.excitation.movement import Excitation, Progress
from orbitfb.loop.frequency import Sight
from orbitfb.observe.clock_watch import ClockWatch
from orbitfb.observe.event_log import EventLog
from orbitfb.observe.last_diagnosis import LastDiagnosis
from orbitfb.observe.metrics.beside import Beside
from orbitfb.observe.statistics.running import LoopStatistics
from orbitfb.physics.places import Ring
from orbitfb.postmortem.frozen import Frozen
from orbitfb.postmortem.log_tap import LogTap
from orbitfb.postmortem.recorder import Listeners, PostMortemRecorder, Run
from orbitfb.safety.believed import Believed

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

    def archive_resumed(self, lost: int) -> None:
        """Take that the archive writes again, and how many ticks it lost since the start."""
        _log.info("archive_resumed", lost=lost)
        told = f"written again; {lost} ticks since the start were not written"
        self._statistics.happened("archive", told)

    def clock_set(self, text: str) -> None:
        """Take that somebody set a clock."""
        _log.warning("clock_set", problem=text)
        self._statistics.happened("clock", text)

    def servers_told(self, text: str) -> None:
        """Take what is to know of the servers of the PVs."""
        _log.warning("servers_of_pvs", problem=text)
        self._statistics.happened("ring", text)

    def rf_told(self, text: str) -> None:
        """Take what is to know of the RF frequency; the log has it already."""
        self._statistics.happened("rf", text)

    def postmortem_written(self, path: Path, frozen: Frozen) -> None:
        """Take that the last seconds are on disk."""
        cause = frozen.cause
        _log.info(
            "postmortem_written",
            path=str(path),
            trigger=cause.trigger,
            tick=cause.tick,
            reason=cause.reason,
            ticks=len(frozen.ticks),
        )
        self._statistics.happened("postmortem", str(path))

    def postmortem_failed(self, problem: str) -> None:
        """Take why a post-mortem is lost."""
        _log.error("postmortem_failed", problem=problem)
        self._statistics.happened("postmortem", problem)

    def postmortems_removed(self, paths: list[Path]) -> None:
        """Take that old post-mortems were removed."""
        _log.info("postmortems_removed", paths=[str(path) for path in paths])

    def ring_died(self, failure: str) -> None:
        """Take why the simulated ring of our own died."""
        self._statistics.happened("ring", failure)


def say_excitation(excitation: Excitation) -> None:
    """Log how far a planned excitation came."""
    progress = excitation.progress
    say = _log.info if progress is Progress.DONE else _log.warning
    say("excitation", progress=progress, ticks=excitation.rows)


def beside(
    config: AppConfig,
    machine: EpicsMachine,
    dither: Dither,
    clocks: ClockWatch,
    statistics: LoopStatistics,
    believed: Callable[[], Believed],
    rf: Callable[[], Sight],
) -> Beside:
    """Say where a scrape finds what is not the loop's own.

    Args:
        config: The configuration.
        machine: Counts its channels.
        dither: The dither.
        clocks: Counts how often a clock was set.
        statistics: Know whether settings are not saved.
        believed: Tells what was asked of the ring.
        rf: Gives how the RF frequency is.
    """
    return Beside(
        channels=machine.channel_counts,
        dither_cost=lambda: dither.orbit_cost,
        diagnosis=LastDiagnosis(config.data_directory),
        period=config.loop.period,
        noise=config.learn.identify.reading_noise,
        most_invalid=config.interlocks.max_invalid_bpms,
        rf=rf,
        clock_steps=lambda: clocks.steps,
        unsaved=lambda: statistics.unsaved(),  # the doors, which know it, are opened later
        believed=believed,
    )


def postmortems(
    config: AppConfig,
    ioc: str,
    channels: Channels,
    counting: Mask,
    reports: Reports,
    stack: ExitStack,
) -> tuple[PostMortemRecorder, ...]:
    """Keep the last seconds of everything for a post-mortem: one recorder, or none if it is off.

    Args:
        config: The configuration; it goes into every file.
        ioc: Where the ring is.
        channels: The names behind the vectors.
        counting: BPMs that are not masked by configuration, shape (n,).
        reports: Told what becomes of them.
        stack: Ends it.
    """
    if not config.postmortem.enabled:
        return ()
    clock = SystemClock()
    recorder = PostMortemRecorder(
        config.data_directory.resolve() / "postmortem",
        config.postmortem,
        Run(channels, counting, to_toml(config), {"ioc": ioc, "started": clock.wall()}),
        Listeners(
            reports.postmortem_written, reports.postmortem_failed, reports.postmortems_removed
        ),
        clock,
    )
    stack.callback(recorder.close)
    stack.callback(LogTap(recorder.tell).close)
    return (recorder,)


def gap_watch(
    config: AppConfig, ring: Ring, history: History, reports: Reports, stack: ExitStack
) -> GapWatch:
    """Watch the gap between model and machine, if that is wanted.

    Args:
        config: The configuration.
        ring: Its ring.
        history: What is looked at.
        reports: Where it reports.
        stack: Ends it.
    """
    layout = layout_of(ring, config.ring.planes, config.loop.period)
    looker = GapProcess(layout)
    watch = GapWatch(
        config.diagnose.live, history, looker.look, reports.gap_seen, reports.look_failed
    )
    if config.diagnose.live.enabled:
        watch.start()
        stack.callback(watch.stop, looker.close)
    return watch


def say_and_log(say: Callable[[str], None], line: str) -> None:
    """Tell how far a start has come, to people and to the log."""
    say(line)
    _log.info("starting", progress=line)
