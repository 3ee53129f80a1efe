"""The composition root: builds everything from the configuration, and starts it."""

import gc
import threading
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path

import structlog

from orbitfb.app.commands.answers import Remote
from orbitfb.app.service.access import reach_ring
from orbitfb.app.service.directory import journal_of, take_directory
from orbitfb.app.service.display import show
from orbitfb.app.service.hand_over import handing_over
from orbitfb.app.service.interfaces import Parts, check_panel, open_doors
from orbitfb.app.service.learning import start_learner
from orbitfb.app.service.loop import build_loop
from orbitfb.app.service.observers import make_observers
from orbitfb.app.service.policies import choose_policies
from orbitfb.app.service.reports import gap_watch, say_and_log, say_excitation
from orbitfb.app.setup.frequency import rf_model, told_rf
from orbitfb.app.setup.startup import announcement, find_ring, planned
from orbitfb.config.tree import AppConfig
from orbitfb.core.clock import SystemClock
from orbitfb.core.errors import ControlError
from orbitfb.core.signals import LoopState
from orbitfb.learn.builders import masked
from orbitfb.measure.left import left_astray
from orbitfb.policies.rf_known import told

_log = structlog.stdlib.get_logger("orbitfb.service")


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
        ring, clock = config.ring.load(), SystemClock()
        channels = ring.channels(config.ring.planes)
        model = rf_model(config, ring, ioc, lambda line: say_and_log(say, line))
        rf = told_rf(model)
        waveform = planned(config, ring, excite, duration) if excite else None
        epics = find_ring(config, ioc)
        check_panel(config, channels)
        take_directory(config, stack)
        access = reach_ring(
            config,
            ring,
            channels,
            epics,
            ioc,
            model is not None,
            self._lease_lost,
            clock,
            stack,
            say,
        )
        policies = choose_policies(config, ring, channels, access, start, asked, say, rf)
        observers = make_observers(config, ioc, channels, access, policies, clock, stack)
        loop = build_loop(
            config, ioc, start, channels, access, policies, observers, waveform, model, clock
        )
        self._access, self._observers, self._loop = access, observers, loop
        self.runner, self.statistics = loop.runner, observers.statistics
        watch = gap_watch(config, ring, observers.history, observers.reports, stack)
        learner = start_learner(
            config,
            channels,
            access,
            policies,
            observers,
            loop.runner,
            watch,
            clock,
            rf,
            stack,
        )
        remote = Remote(
            loop.runner,
            observers.statistics,
            policies.slot,
            policies.store,
            learner,
            channels,
            directory.resolve() / "archive",
            config.loop.period,
            lambda policy: told(masked(policy, access.movable), rf),
            next((its.request for its in observers.recorders), None),
            policies.measured,
        )
        handing = handing_over(
            config,
            access,
            loop.runner,
            observers.latest,
            lambda text: self.statistics.happened("command", text),
            clock,
            stack,
        )
        doors = Parts(
            ring,
            channels,
            access.counting,
            access.movable,
            loop.runner,
            policies.slot,
            policies.store,
            loop.dither,
            observers.latest,
            observers.statistics,
            access.lease,
            access.bounds,
            loop.frequency,
            handing,
            policies.measured,
            access.place,
            journal_of(directory, access, stack),
        )
        opened = open_doors(config, doors, remote, stack)
        handing.start()
        http = show(config, access, observers, loop, opened, duration, stack)
        self.final = observers.statistics.snapshot()
        self._where = {
            "ioc": ioc,
            "addresses": access.epics.searched,
            "port": access.epics.server_port,
            "servers": access.machine.servers(),
            "metrics": http.address,
            "metrics_problem": http.problem,
            "policy": policies.first.policy_id,
            "policy_reason": policies.keeper.reason,
            "data": str(directory.resolve()),
            **opened.where,
        }
        _log.info("service_started", **self._where)
        same = config.measure.same_setpoint
        if astray := left_astray(directory, access.machine, access.place, ioc, same):
            _log.warning("setpoints_astray", problem=astray)
            observers.statistics.happened("measurement", astray)
        self._astray = astray

    def announce(self, say: Callable[[str], None]) -> None:
        """Say what was started where."""
        for line in announcement(self._where, self._access.own is not None):
            say(line)
        for attention in filter(None, (self._astray, self._access.machine.doubled)):
            say(f"attention: {attention}")

    @property
    def ring_failure(self) -> str:
        """Why the simulated ring of our own died; empty while it lives or where there is none."""
        return self._access.failure

    def run(self, stop: threading.Event, duration: float | None) -> None:
        """Run the loop in this thread.

        Args:
            stop: Ends it.
            duration: Ends it after so long [s]; None: never.
        """
        timer = threading.Timer(duration, stop.set) if duration is not None else None
        watcher = None
        if (own := self._access.own) is not None:
            told = self._observers.reports.ring_died
            watcher = threading.Thread(target=own.watch, args=(stop, told), name="sim-watch")
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
            if self._loop.excitation is not None:
                say_excitation(self._loop.excitation)
            if self.runner.failure is not None:
                _log.error("loop_failed", exc_info=self.runner.failure)
            _log.info("service_stopped", state=self.runner.state, reason=self.runner.reason)

    def _lease_lost(self, owner: str) -> None:
        """Open the loop: another controller writes to the machine."""
        _log.error("lease_lost", owner=owner)
        self.statistics.happened("lease", f"taken by {owner}: the loop opens")
        with suppress(ControlError):  # it is open already, or latched
            self.runner.command("open")
