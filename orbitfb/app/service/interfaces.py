"""The doors of a service: the control socket, the panel if that is wanted, the operator page."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import structlog

from orbitfb.app.commands.adjust import Adjuster
from orbitfb.app.commands.autosave import FILE
from orbitfb.app.commands.base import Base
from orbitfb.app.commands.correct import Corrections
from orbitfb.app.commands.correction import Sources as CorrectionSources
from orbitfb.app.commands.dispatch import Commands, Handler
from orbitfb.app.commands.frequency import FrequencyCommands
from orbitfb.app.commands.known_response import KnownResponse
from orbitfb.app.commands.measuring import Measuring
from orbitfb.app.commands.measuring import Sources as MeasuringSources
from orbitfb.app.commands.preview import Latest, Trial
from orbitfb.app.commands.vectors import Sources as VectorSources
from orbitfb.app.commands.vectors import Vectors
from orbitfb.app.service.hand_over import HandingOver
from orbitfb.app.service.page_process import PageProcess
from orbitfb.app.service.panel_process import PanelProcess
from orbitfb.config.tree import AppConfig
from orbitfb.control.server import ControlServer
from orbitfb.core.clock import SystemClock
from orbitfb.core.errors import ControlError
from orbitfb.core.signals import Channels, Mask, Vector
from orbitfb.epics.lease.lease import Lease
from orbitfb.loop.excitation.dither import Dither
from orbitfb.loop.runner import Runner
from orbitfb.loop.slot import PolicySlot
from orbitfb.observe.statistics.running import LoopStatistics
from orbitfb.page.peaks import Peaks
from orbitfb.page.view import PageView, Sources
from orbitfb.panel.access import read_access
from orbitfb.panel.figures import Figures, gap_text
from orbitfb.panel.pv_table import Extent, panel_pvs, writable_names
from orbitfb.physics.places import Ring
from orbitfb.policies.store.directory import PolicyStore
from orbitfb.safety.bounds import Bounds

_log = structlog.stdlib.get_logger("orbitfb.service")


@dataclass(frozen=True, slots=True)
class Parts:
    """What operators see and command.

    Args:
        ring: The ring.
        channels: Of the loop.
        counting: BPMs that are not masked by configuration, shape (n,).
        movable: Correctors that are not, shape (m,).
        runner: The loop.
        slot: Its policy.
        store: The policies.
        dither: The dither.
        latest: The last orbit.
        statistics: Figures of the loop.
        lease: Of the machine; None: there is none.
        bounds: Gives the limits of the setpoints that are in force.
        frequency: The RF.
        handing: The hand-over of our reference to a fast feedback.
        measured: The response that was measured, if one was.
        where: The machine, as messages and journals call it.
        journal: Where a measurement of the response keeps its journal.
    """

    ring: Ring
    channels: Channels
    counting: Mask
    movable: Mask
    runner: Runner
    slot: PolicySlot
    store: PolicyStore
    dither: Dither
    latest: Latest
    statistics: LoopStatistics
    lease: Lease | None
    bounds: Callable[[], Bounds]
    frequency: FrequencyCommands
    handing: HandingOver
    measured: KnownResponse
    where: str
    journal: Path

    @property
    def lease_shown(self) -> dict[str, Any]:
        """Who holds the lease, by PV of the panel."""
        return {"Lease-I": self.lease.owner if self.lease else ""}


@dataclass(frozen=True, slots=True)
class Opened:
    """The doors once they are open.

    Args:
        where: Where the panel is: `panel` and `prefix`; nothing if there is none. Where the
            operator page is: `page`, empty if it is not served, then `page_problem` says why.
        control: The control socket.
    """

    where: Mapping[str, Any]
    control: ControlServer

    @property
    def troubles(self) -> tuple[str, ...]:
        """What does not work now, a sentence each."""
        return (self.control.problem,) if self.control.problem else ()


def check_panel(config: AppConfig, channels: Channels) -> None:
    """Read the access rules of the panel, before anything is started.

    Raises:
        ConfigError: One of them is wrong.
    """
    settings = config.panel
    if settings.enabled:
        names = writable_names(panel_pvs(settings, Extent.of(channels)))
        read_access(settings.rules, settings.interface, names)


def open_doors(config: AppConfig, parts: Parts, remote: Handler, stack: ExitStack) -> Opened:
    """Restore what operators had set, then take their commands.

    Args:
        config: The configuration.
        parts: Of the service.
        remote: Answers the commands that are neither of adjustments nor of trials.
        stack: Closes what is opened here.

    Raises:
        ConfigError: What was saved is damaged or of another ring; a rule is wrong.
        OwnershipError: A socket cannot be made, a port is taken.
    """
    channels, slot, statistics = parts.channels, parts.slot, parts.statistics
    directory = config.data_directory

    def crossed(change: Vector) -> str:
        record, bounds = parts.latest.record, parts.bounds()
        if record is None or not np.isfinite(record.setpoints).all():
            return ""
        beyond = np.abs(change) > bounds.room(change, record.setpoints + record.applied)
        return bounds.name(beyond, channels.correctors)

    base = Base(
        channels, parts.counting, parts.movable, config.panel, directory, parts.ring, crossed
    )

    def saved_late() -> None:
        _log.info("settings_saved", file=str(directory / FILE))
        statistics.happened("command", f"settings of operators saved to {FILE} after all")

    adjuster = Adjuster(base, parts.runner, slot, parts.dither, saved_late)
    stack.callback(adjuster.close)
    statistics.unsaved = lambda: adjuster.unsaved
    statistics.enabled = lambda: parts.runner.adjustments.enabled
    if adjuster.restore():
        _log.info("operator_settings_restored", file=str(directory / FILE))
        statistics.happened("command", f"settings of operators restored from {FILE}")
    trial = Trial(
        slot,
        parts.store,
        channels,
        config.policy.svd,
        parts.latest,
        lambda: adjuster.movable,
        remote,
    )

    def close(request: Mapping[str, Any]) -> Mapping[str, Any]:
        if parts.lease is not None and (reason := parts.lease.refusal()):
            raise ControlError(f"close refused: {reason}")
        return remote(request)

    measuring = Measuring(
        MeasuringSources(
            config,
            parts.ring,
            parts.runner,
            parts.counting,
            lambda: adjuster.movable,
            parts.bounds,
            parts.where,
            parts.journal,
            SystemClock(),
            parts.slot,
            parts.measured,
        ),
        statistics,
    )
    stack.callback(measuring.close)
    peaks = Peaks(channels.planes, channels.bpm_counts)
    parts.runner.subscribe(peaks)
    view = PageView(
        Sources(
            statistics.snapshot,
            lambda: parts.latest.record,
            lambda: parts.runner.adjustments.enabled & parts.counting,
            lambda: adjuster.movable,
            gap_text,
            peaks.since,
            config.learn.identify.reading_noise,
            lambda: parts.frequency.sight,
            lambda: measuring.sight,
            lambda: parts.handing.sight,
        ),
        SystemClock(),
        config.observe.stale_after,
    )
    vectors = Vectors(
        VectorSources(
            channels,
            parts.latest,
            slot,
            lambda: parts.runner.adjustments,
            parts.counting,
            lambda: adjuster.movable,
            parts.bounds,
        )
    )
    corrections = Corrections(
        CorrectionSources(
            channels,
            parts.runner,
            slot,
            parts.latest,
            config.policy.svd,
            lambda: adjuster.movable,
            parts.bounds,
            config.correction,
            config.loop.period,
            parts.measured,
        ),
        statistics,
        SystemClock(),
    )
    commands = Commands(
        {
            "": remote,
            "page": view,
            "close": parts.handing.closing(close),
            "open": parts.handing.opening(remote),
            **adjuster.handlers,
            **trial.handlers,
            **corrections.handlers,
            **measuring.handlers,
            **parts.frequency.handlers,
        },
        statistics,
        Figures(config.observe.stale_after),
        lambda: {
            **adjuster.shown(),
            **trial.shown(),
            **vectors.shown(),
            **corrections.shown(),
            **measuring.shown(),
            **parts.frequency.shown(),
            **parts.handing.shown(),
            **parts.lease_shown,
        },
    )
    control = ControlServer(directory, commands)
    stack.callback(control.close)
    page = PageProcess(config, channels, statistics, stack)
    where = {"page": page.where, "page_problem": page.problem}
    if not config.panel.enabled:
        return Opened(where, control)
    panel = PanelProcess(config, channels, statistics, stack)
    return Opened({**where, "panel": panel.where, "prefix": panel.prefix}, control)
