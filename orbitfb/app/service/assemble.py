"""The composition root: builds everything from the configuration, and starts it."""

import gc
import tempfile
import threading
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import structlog

from orbitfb.app.commands.answers import Remote
from orbitfb.app.commands.frequency import FrequencyCommands
from orbitfb.app.commands.preview import Latest
from orbitfb.app.service.active_policy import Keeper
from orbitfb.app.service.interfaces import Parts, check_panel, open_doors
from orbitfb.app.service.reports import (
    Reports,
    beside,
    gap_watch,
    postmortems,
    say_and_log,
    say_excitation,
)
from orbitfb.app.setup.frequency import follower_of, rf_model, with_rf
from orbitfb.app.setup.lease import take_lease
from orbitfb.app.setup.simulated_ring import SimulatedRing
from orbitfb.app.setup.startup import (
    SIMULATED,
    announcement,
    dither_settings,
    find_ring,
    make_directory,
    planned,
    questioner,
    take_ring,
)
from orbitfb.app.setup.stored_policies import (
    baseline,
    check_policy,
    open_store,
    safeguards,
    sim_job,
    trainer,
)
from orbitfb.config.tree import AppConfig
from orbitfb.core.clock import SystemClock
from orbitfb.core.errors import ConfigError, ControlError
from orbitfb.core.files.ownership import Lock
from orbitfb.core.ports import Machine
from orbitfb.core.signals import LoopState
from orbitfb.diagnose.live.broken import Screen
from orbitfb.epics.machine import EpicsMachine
from orbitfb.history.archive import ArchiveWriter
from orbitfb.history.buffer import History
from orbitfb.learn.answered import AnsweredRows
from orbitfb.learn.builders import loop_gain, masked
from orbitfb.learn.worker import LearnerThread
from orbitfb.loop.excitation.dither import Dither
from orbitfb.loop.excitation.movement import Excitation
from orbitfb.loop.machines.guarded import GuardedMachine
from orbitfb.loop.machines.masked import MaskedMachine
from orbitfb.loop.machines.stepped import rounding_told, stepped
from orbitfb.loop.runner import Runner
from orbitfb.loop.slot import PolicySlot
from orbitfb.measure.left import DIRECTORY, left_astray
from orbitfb.observe.clock_watch import ClockWatch
from orbitfb.observe.event_log import EventLog
from orbitfb.observe.http import ObserveServer
from orbitfb.observe.logs import configure_logs
from orbitfb.observe.metrics.collector import metrics_registry
from orbitfb.observe.rf_news import RfNews
from orbitfb.observe.server_news import ServerNews
from orbitfb.observe.statistics.running import LoopStatistics
from orbitfb.observe.terminal import Terminal
from orbitfb.observe.view import Surroundings
from orbitfb.physics.response import response as optics
from orbitfb.policies.masking import mask_of
from orbitfb.policies.stability import is_unstable, unstable_on, warning_of
from orbitfb.policies.trips import TripNotes
from orbitfb.safety.bounds import Bounds, narrower

_log = structlog.stdlib.get_logger("orbitfb.service")

SHORTEST_POLL, LONGEST_POLL = 0.02, 0.2
"""Bounds of how often the learner looks for new ticks [s]."""


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
        asked: Whether the kind of policy was asked for at this start.
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
        asked: bool = False,
    ) -> None:
        directory = config.data_directory
        ring = config.ring.load()
        self.channels = ring.channels(config.ring.planes)
        model = rf_model(config, ring, ioc, lambda line: say_and_log(say, line))
        waveform = planned(config, ring, excite, duration) if excite else None
        epics = find_ring(config, ioc)
        check_panel(config, self.channels)
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
        self._own_ring = SimulatedRing(sim_job(config), stack) if ioc == SIMULATED else None
        if self._own_ring is not None:
            epics = self._own_ring.settings(config)
        if model is not None:
            epics = with_rf(epics, config)
        take_ring(epics, self.channels, stack)
        self.lease = take_lease(config, epics, self._lease_lost, stack)
        clock = SystemClock()
        counting, movable = mask_of(self.channels, config.masks)
        rf_pv = "" if model is None else config.rf.setpoint_pv
        self.machine = EpicsMachine(self.channels, epics, clock, counting, movable, rf_pv)
        stack.callback(self.machine.close)
        names, limit = self.channels.correctors, config.limits.setpoint
        if told := narrower(limit, self.machine.drive_limits, names):
            say_and_log(say, told)
        bounds = Bounds.of(limit, len(names), self.machine.drive_limits)
        steps = self.machine.steps
        matrix = optics(ring, config.ring.planes)
        if told := rounding_told(steps, matrix, self.channels.setpoint_pvs):
            say_and_log(say, told)
        machine: Machine = self.machine
        machine = stepped(machine, steps, limit, lambda: self.machine.drive_limits)
        if self.lease is not None:
            machine = GuardedMachine(machine, self.lease.refusal)
        if not counting.all():
            machine = MaskedMachine(machine, counting)
        self.store = open_store(config)
        keeper = Keeper(
            self.store, self.channels, config.policies_kept, watches=config.learn.enabled
        )
        nominal = baseline(config, ring, lambda line: say_and_log(say, line))
        check_policy(nominal, config)
        first = keeper.first(nominal, movable, ioc == SIMULATED, asked)
        measured = nominal.response if config.ring.response is not None else None
        lost = "" if measured is None else unstable_on(first, measured)
        if lost and start is LoopState.CLOSED:
            raise ConfigError(f"the loop does not start closed: policy {first.policy_id} {lost}")
        self.slot = PolicySlot(first)
        self.statistics = LoopStatistics(self.channels, bounds.largest, clock, counting)
        if warning := warning_of(first):
            word = "policy_unstable" if is_unstable(warning) else "policy_near_its_limit"
            _log.warning(word, policy=first.policy_id, problem=warning)
            self.statistics.happened("policy", f"{first.policy_id} is {warning}")
        self.events = EventLog(self.channels, clock, config.observe.logs.quiet_time, counting)
        self._reports = Reports(self.statistics, self.events)
        self.history = History(self.channels, config.history.capacity)
        archive = ArchiveWriter(
            directory / "archive",
            self.channels,
            config.history.archive,
            self._reports.archive_failed,
            on_resumed=self._reports.archive_resumed,
        )
        stack.callback(archive.close)
        below = Dither(dither_settings(config), nominal.response, loop_gain(nominal), movable)
        self._dither = Excitation(waveform, below) if waveform else below
        recorders = postmortems(config, ioc, self.channels, counting, self._reports, stack)
        latest, clocks = Latest(), ClockWatch(clock, self._reports.clock_set)
        trips = TripNotes(self.store, config.interlocks)
        stack.callback(trips.close)
        news = ServerNews(lambda: self.machine.doubled, self._reports.servers_told)
        follower = follower_of(self.machine.oscillator, model, config, self._obstacle)
        frequency = FrequencyCommands(follower)
        if follower is not None:
            rf_news = RfNews(lambda: follower.sight, clock, self._reports.rf_told)
            news_of_rf = (rf_news,)
        else:
            news_of_rf = ()
        told = (self.events, latest, clocks, trips, news, *news_of_rf, *recorders)
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
            subscribers=(self.history, archive, self.statistics, *told),
            counting=counting,
            safeguards=replace(
                safeguards(nominal, config, movable),
                obstacle=self._obstacle,
                drive_limits=lambda: self.machine.drive_limits,
            ),
            heed=self.machine.count_bpms,
            random=questioner(config, ioc),
            follower=follower,
            correction=config.correction,
        )
        self.watch = gap_watch(config, ring, self.history, self._reports, stack)
        self.learner: LearnerThread | None = None
        if config.learn.enabled:
            rows = Screen(self.history, self.channels, self.watch.broken, config.interlocks)
            self.learner = LearnerThread(
                trainer(config, first.response, movable),
                rows,
                self.slot,
                self._reports.refitted,
                keep=keeper.keep,
                poll=min(LONGEST_POLL, max(SHORTEST_POLL, 2.0 * config.loop.period)),
                limits=config.limits,
                alarmed=self._reports.alarmed,
                tripped=lambda: self.runner.state is LoopState.TRIPPED,
                clock=clock,
                records=keeper,
                teaching=AnsweredRows(rows, lambda: self.runner.believed),
            )
            if going_on := keeper.resumed:
                probation = going_on.probation
                self.learner.resume(going_on.former, probation.before, probation.seen)
            self.learner.start()
            stack.callback(self.learner.stop)
        registry = metrics_registry(
            self.statistics.snapshot,
            archive.status,
            recorders[0].status if recorders else None,
            beside(
                config,
                self.machine,
                below,
                clocks,
                self.statistics,
                lambda: self.runner.believed,
                lambda: frequency.sight,
            ),
        )
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
            next((its.request for its in recorders), None),
            measured,
        )
        doors = Parts(
            ring,
            self.channels,
            counting,
            movable,
            self.runner,
            self.slot,
            self.store,
            below,
            latest,
            self.statistics,
            self.lease,
            lambda: Bounds.of(limit, len(names), self.machine.drive_limits),
            frequency,
            measured,
            f"{epics.searched}:{epics.server_port}",
            self._journal(directory, stack),
        )
        opened = open_doors(config, doors, remote, stack)
        http = ObserveServer(
            config.observe, registry, self.statistics.snapshot, lambda: opened.troubles
        )
        http.start()
        stack.callback(http.stop)
        terminal = Terminal(
            self.statistics.snapshot,
            config.observe.terminal,
            Surroundings(
                metrics=http.address,
                duration=duration,
                ring=f"{epics.searched}:{epics.server_port}",
                trouble=lambda: self.ring_failure or archive.status().problem,
            ),
        )
        terminal.start()
        stack.callback(terminal.stop)
        self.final = self.statistics.snapshot()
        self._where = {
            "ioc": ioc,
            "addresses": epics.searched,
            "port": epics.server_port,
            "servers": self.machine.servers(),
            "metrics": http.address,
            "metrics_problem": http.problem,
            "policy": first.policy_id,
            "policy_reason": keeper.reason,
            "data": str(directory.resolve()),
            **opened.where,
        }
        _log.info("service_started", **self._where)
        place, same = f"{epics.searched}:{epics.server_port}", config.measure.same_setpoint
        if astray := left_astray(directory, self.machine, place, ioc, same):
            _log.warning("setpoints_astray", problem=astray)
            self.statistics.happened("measurement", astray)
        self._astray = astray

    def announce(self, say: Callable[[str], None]) -> None:
        """Say what was started where."""
        for line in announcement(self._where, self._own_ring is not None):
            say(line)
        for attention in filter(None, (self._astray, self.machine.doubled)):
            say(f"attention: {attention}")

    @property
    def ring_failure(self) -> str:
        """Why the simulated ring of our own died; empty while it lives or where there is none."""
        return self._own_ring.failure if self._own_ring is not None else ""

    def run(self, stop: threading.Event, duration: float | None) -> None:
        """Run the loop in this thread.

        Args:
            stop: Ends it.
            duration: Ends it after so long [s]; None: never.
        """
        timer = threading.Timer(duration, stop.set) if duration is not None else None
        watcher = None
        if self._own_ring is not None:
            watcher = threading.Thread(
                target=self._own_ring.watch, args=(stop, self._reports.ring_died), name="sim-watch"
            )
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
            if watcher is not None:
                watcher.join()
            self.final = self.statistics.snapshot()
            if isinstance(self._dither, Excitation):
                say_excitation(self._dither)
            if self.runner.failure is not None:
                _log.error("loop_failed", exc_info=self.runner.failure)
            _log.info("service_stopped", state=self.runner.state, reason=self.runner.reason)

    def _journal(self, directory: Path, stack: ExitStack) -> Path:
        """Say where a measurement keeps its journal: that of a simulated ring ends with it."""
        if self._own_ring is None:
            return directory / DIRECTORY
        return Path(stack.enter_context(tempfile.TemporaryDirectory()))

    def _obstacle(self) -> str:
        """Say why the machine must not be written to now; empty when it may."""
        return self.lease.refusal() if self.lease is not None else ""

    def _lease_lost(self, owner: str) -> None:
        """Open the loop: another controller writes to the machine."""
        _log.error("lease_lost", owner=owner)
        self.statistics.happened("lease", f"taken by {owner}: the loop opens")
        with suppress(ControlError):  # it is open already, or latched
            self.runner.command("open")
