"""The composition root: builds everything from the configuration, starts it, waits, stops it."""

import gc
import threading
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import structlog

from orbitfb.config import AppConfig
from orbitfb.control import ControlServer, Lock
from orbitfb.core.clock import SystemClock
from orbitfb.core.errors import ArchiveError, EstimationError, MachineError, OrbitFeedbackError
from orbitfb.core.gap import GapSight
from orbitfb.core.ports import Machine, Policy
from orbitfb.core.refit import Alarm, Decision, RefitReport
from orbitfb.core.signals import LoopState
from orbitfb.diagnose.broken import Screen
from orbitfb.diagnose.live import GapProcess, GapWatch
from orbitfb.effects.build import layout_of
from orbitfb.epics.machine import EpicsMachine
from orbitfb.epics.settings import AuxiliarySettings, EpicsSettings
from orbitfb.history.archive import ArchiveWriter
from orbitfb.history.buffer import History
from orbitfb.learn.builders import ResponsePolicy, loop_gain, masked
from orbitfb.learn.worker import LearnerThread
from orbitfb.loop.dither import Dither
from orbitfb.loop.excitation import Excitation, Progress
from orbitfb.loop.masked import MaskedMachine
from orbitfb.loop.runner import Runner
from orbitfb.loop.slot import PolicySlot
from orbitfb.maintenance import baseline, open_store, sim_job, trainer
from orbitfb.observe.event_log import EventLog
from orbitfb.observe.http import ObserveServer
from orbitfb.observe.logs import configure_logs
from orbitfb.observe.metrics import metrics_registry
from orbitfb.observe.statistics import TRUE_RMS, LoopStatistics
from orbitfb.observe.summary import check_place, write_summary
from orbitfb.observe.terminal import Terminal
from orbitfb.observe.view import Surroundings
from orbitfb.physics.places import Ring
from orbitfb.policies.masking import mask_of
from orbitfb.policies.stability import growth_of, warning_of
from orbitfb.remote import Remote
from orbitfb.sim.child import SimChild
from orbitfb.sim.layout import TRUE_RMS_PV
from orbitfb.startup import (
    SIMULATED,
    StopSignals,
    announcement,
    check_duration,
    check_limits,
    dither_settings,
    find_ring,
    make_directory,
    planned,
    start_state,
    take_ring,
)

_log = structlog.stdlib.get_logger("orbitfb.service")

SHORTEST_POLL, LONGEST_POLL = 0.02, 0.2
"""Bounds of how often the learner looks for new ticks [s]."""
CHILD_PERIOD = 0.5
"""How often to look whether the simulated ring of our own is alive [s]."""


def run_service(
    config: AppConfig,
    ioc: str,
    start: str | None = None,
    duration: float | None = None,
    summary_file: Path | None = None,
    announce: Callable[[str], None] = lambda _: None,
    excite: Path | None = None,
) -> int:
    """Run the loop until a signal, the end of the duration, or FAULT.

    Args:
        config: The configuration.
        ioc: `sim`, `env`, `config` or `HOST[:PORT]`.
        start: State to start in; by default CLOSED on a simulated ring of our own, else OPEN.
        duration: Time to run [s]; None: until a signal.
        summary_file: Where to write the figures of the run.
        announce: Gets a few lines about what was started where.
        excite: File of an excitation, to be done once.

    Returns:
        The exit code: 0, or 1 after FAULT.

    Raises:
        OrbitFeedbackError: It could not start, or its simulated ring died and none came back;
            nothing is left running.
    """
    state = start_state(start, ioc)
    check_duration(duration)
    if summary_file is not None:
        check_place(summary_file)
    with StopSignals() as signals, ExitStack() as stack:
        try:
            service = Service(config, ioc, state, duration, stack, excite, announce)
        except OrbitFeedbackError as error:
            if structlog.is_configured():  # the log is open
                _log.error("start_failed", problem=str(error))
            raise
        service.announce(announce)
        signals.hand_over()
        service.run(signals.stop, duration)
    if summary_file is not None:
        write_summary(summary_file, service.final)
    if service.ring_failure and service.runner.state is LoopState.HELD:
        raise MachineError(service.ring_failure)
    return 1 if service.runner.state is LoopState.FAULT else 0


class Service:
    """Everything that runs beside the loop, and the loop.

    Args:
        config: The configuration.
        ioc: `sim`, `env`, `config` or `HOST[:PORT]`.
        start: State to start in.
        duration: Time to run [s], for the display; None: until stopped.
        stack: Closes what is opened here, in reverse order.
        excite: File of an excitation.
        say: Gets a line now and then about what takes long before the loop runs.
    """

    def __init__(
        self,
        config: AppConfig,
        ioc: str,
        start: LoopState,
        duration: float | None,
        stack: ExitStack,
        excite: Path | None = None,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        directory = config.data_directory
        ring = config.ring.load()
        self.channels = ring.channels(config.ring.planes)
        waveform = planned(config, ring, excite, duration) if excite else None
        epics = find_ring(config, ioc)
        make_directory(directory)
        stack.enter_context(
            Lock(
                f"data {directory.resolve()}",
                f"the data directory {directory}",
                "stop it, or name another directory with --data",
            )
        )
        logs = configure_logs(config.observe.logs, directory)
        stack.callback(logs.close)
        self._child: SimChild | None = None
        self.ring_failure = ""
        if ioc == SIMULATED:
            epics = self._serve_ring(config, stack)
        take_ring(epics, self.channels, stack)
        clock = SystemClock()
        self.machine = EpicsMachine(self.channels, epics, clock)
        stack.callback(self.machine.close)
        check_limits(config, self.machine.drive_limits, self.channels)

        counting, movable = mask_of(self.channels, config.masks)
        machine: Machine = self.machine
        if not counting.all():
            machine = MaskedMachine(machine, counting)
        self._movable = movable
        self.store = open_store(config)
        self._policies_kept = config.policies_kept
        nominal = baseline(config, ring, lambda line: _say_and_log(say, line))
        first = self._first_policy(nominal, ioc)
        self.slot = PolicySlot(first)
        self.statistics = LoopStatistics(self.channels, config.limits.setpoint, clock, counting)
        if warning := warning_of(growth_of(first)):
            _log.warning("policy_unstable", policy=first.policy_id, problem=warning)
            self.statistics.happened("policy", f"{first.policy_id} is {warning}")
        self.events = EventLog(self.channels, clock, config.observe.logs.quiet_time, counting)
        self.history = History(self.channels, config.history.capacity)
        archive = ArchiveWriter(
            directory / "archive", self.channels, config.history.archive, self._archive_failed
        )
        stack.callback(archive.close)
        below = Dither(dither_settings(config), nominal.response, loop_gain(nominal), movable)
        self._dither = Excitation(waveform, below) if waveform else below
        self.runner = Runner(
            machine,
            self.slot,
            config.loop,
            config.limits,
            config.interlocks,
            np.zeros(len(self.channels.bpms)),
            clock,
            dither=self._dither,
            start=start,
            subscribers=(self.history, archive, self.statistics, self.events),
            counting=counting,
        )
        self.watch = self._gap_watch(config, ring, stack)
        self.learner: LearnerThread | None = None
        if config.learn.enabled:
            self.learner = LearnerThread(
                trainer(config, first.response, movable),
                Screen(self.history, self.channels, self.watch.broken),
                self.slot,
                self._refitted,
                keep=self._keep,
                poll=min(LONGEST_POLL, max(SHORTEST_POLL, 2.0 * config.loop.period)),
                limits=config.limits,
                alarmed=self._alarmed,
                tripped=lambda: self.runner.state is LoopState.TRIPPED,
                clock=clock,
            )
            self.learner.start()
            stack.callback(self.learner.stop)
        registry = metrics_registry(self.statistics.snapshot, archive.status)
        http = ObserveServer(config.observe, registry, self.statistics.snapshot)
        http.start()
        stack.callback(http.stop)
        remote = Remote(
            self.runner,
            self.statistics,
            self.slot,
            self.store,
            self.learner,
            self.channels,
            directory.resolve() / "archive",
            config.loop.period,
            lambda policy: masked(policy, movable),
        )
        stack.callback(ControlServer(directory, remote).close)
        terminal = Terminal(
            self.statistics.snapshot,
            config.observe.terminal,
            Surroundings(
                metrics=http.address,
                duration=duration,
                ring=f"{epics.address_list}:{epics.server_port}",
                trouble=lambda: self.ring_failure or archive.status().problem,
            ),
        )
        terminal.start()
        stack.callback(terminal.stop)
        self.final = self.statistics.snapshot()
        self._where = {
            "ioc": ioc,
            "addresses": epics.address_list,
            "port": epics.server_port,
            "metrics": http.address,
            "policy": self.slot.current.policy_id,
            "data": str(directory.resolve()),
        }
        _log.info("service_started", **self._where)

    def announce(self, say: Callable[[str], None]) -> None:
        """Say what was started where."""
        for line in announcement(self._where, self._child is not None):
            say(line)

    def run(self, stop: threading.Event, duration: float | None) -> None:
        """Run the loop in this thread.

        Args:
            stop: Ends it.
            duration: Ends it after so long [s]; None: never.
        """
        timer = threading.Timer(duration, stop.set) if duration is not None else None
        watcher = threading.Thread(target=self._watch_child, args=(stop,), name="sim-watch")
        for thread in filter(None, (timer, watcher)):
            thread.daemon = True
            thread.start()
        gc.collect()
        gc.freeze()  # what lives until the end is not walked through in the middle of a tick
        try:
            self.runner.run(stop)
        finally:
            if timer is not None:
                timer.cancel()
            stop.set()
            watcher.join()
            self.final = self.statistics.snapshot()
            self._say_excitation()
            if self.runner.failure is not None:
                _log.error("loop_failed", exc_info=self.runner.failure)
            _log.info("service_stopped", state=self.runner.state, reason=self.runner.reason)

    def _say_excitation(self) -> None:
        """Say how far a planned excitation came."""
        if isinstance(self._dither, Excitation):
            progress = self._dither.progress
            say = _log.info if progress is Progress.DONE else _log.warning
            say("excitation", progress=progress, ticks=self._dither.rows)

    def _watch_child(self, stop: threading.Event) -> None:
        """Say it when the simulated ring of our own has died; the loop holds until one is back."""
        while self._child is not None and not stop.wait(CHILD_PERIOD):
            if not self._child.alive:
                words = self._child.last_words() or "it said nothing"
                self.ring_failure = (
                    f"the simulated ring (process {self._child.pid}) died: {words}; "
                    f"`orbitfb ioc --port {self._child.port}` brings one back"
                )
                _log.error("simulated_ring_died", problem=self.ring_failure)
                self.statistics.happened("ring", self.ring_failure)
                return

    def _serve_ring(self, config: AppConfig, stack: ExitStack) -> EpicsSettings:
        """Start a simulated ring of our own and say how to reach it."""
        self._child = SimChild(sim_job(config))
        port = self._child.start()
        stack.callback(self._child.stop)
        true_rms = AuxiliarySettings(pv=TRUE_RMS_PV, scale=1e-3)
        return config.epics.model_copy(
            update={
                "address_list": config.sim.interface,
                "auto_address_list": False,
                "server_port": port,
                "auxiliary": {**config.epics.auxiliary, TRUE_RMS: true_rms},
            }
        )

    def _first_policy(self, nominal: ResponsePolicy, ioc: str) -> ResponsePolicy:
        """Take up the stored policy; a simulated ring of our own is new and gets the baseline."""
        active = self.store.active()
        if ioc != SIMULATED and active is not None:
            return masked(self.store.load(active, self.channels), self._movable)
        self.store.save(nominal, self.channels)
        self.store.activate(nominal.policy_id)
        return nominal

    def _keep(self, policy: Policy, report: RefitReport) -> None:
        """Store a policy that the judge accepted; activate one that goes in or back in force."""
        if report.decision is Decision.ROLLED_BACK:
            self.store.withdraw(report.policy_id, policy.policy_id)
        else:
            self.store.save(
                policy, self.channels, parent=report.incumbent_id, figures=report.figures
            )
        if report.decision is Decision.PROMOTED:
            self.store.activate(policy.policy_id)
        self.store.prune(self._policies_kept)

    def _gap_watch(self, config: AppConfig, ring: Ring, stack: ExitStack) -> GapWatch:
        """Watch the gap between model and machine, if that is wanted."""
        layout = layout_of(ring, config.ring.planes, config.loop.period)
        looker = GapProcess(layout)
        watch = GapWatch(
            config.diagnose.live, self.history, looker.look, self._gap_seen, self._look_failed
        )
        if config.diagnose.live.enabled:
            watch.start()
            stack.callback(watch.stop, looker.close)
        return watch

    def _gap_seen(self, sight: GapSight) -> None:
        self.statistics.gap_seen(sight)
        self.events.gap_seen(sight)

    def _look_failed(self, error: EstimationError) -> None:
        _log.warning("gap_watch_failed", problem=str(error))

    def _refitted(self, report: RefitReport) -> None:
        self.statistics.refitted(report)
        self.events.refitted(report)

    def _alarmed(self, alarm: Alarm) -> None:
        self.statistics.alarmed(alarm)
        self.events.alarmed(alarm)

    def _archive_failed(self, error: ArchiveError) -> None:
        _log.error("archive_failed", problem=str(error))
        self.statistics.happened("archive", str(error))


def _say_and_log(say: Callable[[str], None], line: str) -> None:
    say(line)
    _log.info("starting", progress=line)
