"""The composition root: builds everything from the configuration, starts it, waits, stops it."""

import gc
import os
import signal
import threading
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import structlog

from orbitfb.config import AppConfig
from orbitfb.control import ControlServer, Lock
from orbitfb.core.clock import SystemClock
from orbitfb.core.errors import ArchiveError, ConfigError, ControlError
from orbitfb.core.ports import Policy
from orbitfb.core.refit import Decision, RefitReport
from orbitfb.core.signals import Channels, LoopState
from orbitfb.epics.machine import EpicsMachine
from orbitfb.epics.settings import AuxiliarySettings, EpicsSettings
from orbitfb.history.archive import ArchiveWriter
from orbitfb.history.buffer import History
from orbitfb.learn.learner import Learner
from orbitfb.learn.worker import LearnerThread
from orbitfb.loop.dither import Dither
from orbitfb.loop.runner import Runner
from orbitfb.loop.slot import PolicySlot
from orbitfb.maintenance import baseline, open_store, policy_builder, sim_job
from orbitfb.observe.event_log import EventLog
from orbitfb.observe.http import ObserveServer
from orbitfb.observe.logs import configure_logs
from orbitfb.observe.metrics import ArchiveFigures, metrics_registry
from orbitfb.observe.statistics import TRUE_RMS, LoopStatistics
from orbitfb.observe.summary import write_summary
from orbitfb.observe.terminal import Terminal
from orbitfb.observe.view import Surroundings
from orbitfb.sim.child import SimChild
from orbitfb.sim.layout import TRUE_RMS_PV

_log = structlog.stdlib.get_logger("orbitfb.service")

SIMULATED = "sim"
ENVIRONMENT = "env"
COMMAND_TIMEOUT = 5.0
"""How long a command may wait for the tick at which it takes effect [s]."""


def run_service(
    config: AppConfig,
    ioc: str,
    start: str | None = None,
    duration: float | None = None,
    summary: Path | None = None,
) -> int:
    """Run the loop until a signal, the end of the duration, or FAULT.

    Args:
        config: The configuration.
        ioc: `sim`, `env` or `HOST[:PORT]`.
        start: State to start in; by default CLOSED on a simulated ring of our own, else OPEN.
        duration: Time to run [s]; None: until a signal.
        summary: Where to write the figures of the run.

    Returns:
        The exit code: 0, or 1 after FAULT.

    Raises:
        OrbitFeedbackError: It could not start; nothing is left running.
    """
    state = _start_state(start, ioc)
    stop = threading.Event()
    with _stopped_by_signals(stop), ExitStack() as stack:
        service = Service(config, ioc, state, duration, stack)
        if summary is not None:
            write_summary(summary, service.final)  # a place that cannot be written is known now
        service.run(stop, duration)
    if summary is not None:
        write_summary(summary, service.final)
    return 1 if service.runner.state is LoopState.FAULT else 0


def _start_state(start: str | None, ioc: str) -> LoopState:
    if start is None:
        return LoopState.CLOSED if ioc == SIMULATED else LoopState.OPEN
    try:
        return LoopState(start.upper())
    except ValueError:
        raise ConfigError(f"--start {start}: choose open, shadow or closed") from None


@contextmanager
def _stopped_by_signals(stop: threading.Event) -> Iterator[None]:
    """Let SIGINT and SIGTERM set the event; a second one ends the process at once."""

    def handle(number: int, _frame: object) -> None:
        if stop.is_set():
            os._exit(128 + number)
        stop.set()

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class Service:
    """Everything that runs beside the loop, and the loop.

    Args:
        config: The configuration.
        ioc: `sim`, `env` or `HOST[:PORT]`.
        start: State to start in.
        duration: Time to run [s], for the display; None: until stopped.
        stack: Closes what is opened here, in reverse order.
    """

    def __init__(
        self,
        config: AppConfig,
        ioc: str,
        start: LoopState,
        duration: float | None,
        stack: ExitStack,
    ) -> None:
        directory = config.data_directory
        ring = config.ring.load()
        self.channels = ring.channels(config.ring.planes)
        _make_directory(directory)
        stack.enter_context(
            Lock(
                f"data {directory.resolve()}",
                f"the data directory {directory}",
                "stop it, or name another directory with --data",
            )
        )
        logs = configure_logs(config.observe.logs, directory)
        stack.callback(logs.close)
        epics = self._open_ring(config, ioc, stack)
        stack.enter_context(
            Lock(
                f"ring {epics.address_list} {epics.server_port} {self.channels.setpoint_pvs[0]}",
                f"the ring at {epics.address_list}, port {epics.server_port},",
                "two loops on one ring fight each other; stop the other one first",
            )
        )
        clock = SystemClock()
        self.machine = EpicsMachine(self.channels, epics, clock)
        stack.callback(self.machine.close)
        _check_limits(config, self.machine.drive_limits, self.channels)

        self.store = open_store(config)
        nominal = baseline(config, ring)
        self.slot = PolicySlot(self._first_policy(nominal, ioc))
        self.statistics = LoopStatistics(self.channels, config.limits.setpoint, clock)
        self.events = EventLog(self.channels, clock, config.observe.logs.quiet_time)
        self.history = History(self.channels, config.history.capacity)
        archive = ArchiveWriter(
            directory / "archive", self.channels, config.history.archive, _archive_failed
        )
        stack.callback(archive.close)
        dither = Dither(
            config.dither.model_copy(update={"seed": config.seed}),
            nominal.response,
            config.policy.gain,
        )
        self.runner = Runner(
            self.machine,
            self.slot,
            config.loop,
            config.limits,
            config.interlocks,
            np.zeros(len(self.channels.bpms)),
            clock,
            dither=dither,
            start=start,
            subscribers=(self.history, archive, self.statistics, self.events),
        )
        learner = Learner(nominal.response, config.learn, policy_builder(config))
        self.learner = LearnerThread(
            learner,
            self.history,
            self.slot,
            self._refitted,
            keep=self._keep,
        )
        if config.learn.enabled:
            self.learner.start()
            stack.callback(self.learner.stop)
        registry = metrics_registry(
            self.statistics.snapshot,
            lambda: ArchiveFigures(archive.status().written, archive.status().dropped),
        )
        http = ObserveServer(config.observe, registry, self.statistics.snapshot)
        http.start()
        stack.callback(http.stop)
        control = ControlServer(directory, self.answer)
        stack.callback(control.close)
        terminal = Terminal(
            self.statistics.snapshot,
            config.observe.terminal,
            Surroundings(http.address, duration),
        )
        terminal.start()
        stack.callback(terminal.stop)
        self.final = self.statistics.snapshot()
        _log.info(
            "service_started",
            ioc=ioc,
            port=epics.server_port,
            metrics=http.address,
            policy=self.slot.current.policy_id,
            data=str(directory.resolve()),
        )

    def run(self, stop: threading.Event, duration: float | None) -> None:
        """Run the loop in this thread.

        Args:
            stop: Ends it.
            duration: Ends it after so long [s]; None: never.
        """
        timer = threading.Timer(duration, stop.set) if duration is not None else None
        if timer is not None:
            timer.daemon = True
            timer.start()
        gc.collect()
        gc.freeze()  # what lives until the end is not walked through in the middle of a tick
        try:
            self.runner.run(stop)
        finally:
            if timer is not None:
                timer.cancel()
            self.final = self.statistics.snapshot()
            if self.runner.failure is not None:
                _log.error("loop_failed", exc_info=self.runner.failure)
            _log.info("service_stopped", state=self.runner.state, reason=self.runner.reason)

    def answer(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        """Carry out a command that came over the control socket.

        Raises:
            ControlError: It is unknown, or refused.
        """
        name = request.get("command")
        if name == "status":
            return self._status()
        if name == "refit":
            activate = bool(request.get("activate", False))
            return asdict(self.learner.request(activate).result(COMMAND_TIMEOUT * 10))
        if name == "activate":
            return self._activate(request.get("policy"))
        try:
            state = self.runner.command(str(name)).result(COMMAND_TIMEOUT)
        except TimeoutError:
            raise ControlError(f"{name}: no tick came within {COMMAND_TIMEOUT} s") from None
        return {"state": state, "reason": self.runner.reason}

    def _status(self) -> Mapping[str, Any]:
        from orbitfb.observe.summary import summary

        return summary(self.statistics.snapshot())

    def _activate(self, policy_id: str | None) -> Mapping[str, Any]:
        if policy_id is None:
            policy_id = self.store.rollback()
        policy = self.store.load(policy_id, self.channels)
        self.store.activate(policy_id)
        before = self.slot.swap(policy)
        return {"policy": policy_id, "before": before.policy_id}

    def _open_ring(self, config: AppConfig, ioc: str, stack: ExitStack) -> EpicsSettings:
        """Find out where the ring is; start it if it is a simulated one of our own."""
        if ioc == ENVIRONMENT:
            return config.epics.model_copy(update=_from_environment())
        if ioc != SIMULATED:
            host, port = _host_and_port(ioc, config.sim.port)
            return config.epics.model_copy(update={"address_list": host, "server_port": port})
        child = SimChild(sim_job(config))
        port = child.start()
        stack.callback(child.stop)
        true_rms = AuxiliarySettings(pv=TRUE_RMS_PV, scale=1e-3)
        return config.epics.model_copy(
            update={
                "address_list": config.sim.interface,
                "server_port": port,
                "auxiliary": {**config.epics.auxiliary, TRUE_RMS: true_rms},
            }
        )

    def _first_policy(self, nominal: Policy, ioc: str) -> Policy:
        """Take up the stored policy; a simulated ring of our own is new and gets the baseline."""
        active = self.store.active()
        if ioc != SIMULATED and active is not None:
            return self.store.load(active, self.channels)
        self.store.save(nominal, self.channels)
        self.store.activate(nominal.policy_id)
        return nominal

    def _keep(self, policy: Policy, report: RefitReport) -> None:
        """Store a policy that the learner is about to put in force, or back in force."""
        if report.decision is Decision.PROMOTED:
            self.store.save(
                policy, self.channels, parent=report.incumbent_id, figures=report.figures
            )
        self.store.activate(policy.policy_id)

    def _refitted(self, report: RefitReport) -> None:
        self.statistics.refitted(report)
        self.events.refitted(report)


def _archive_failed(error: ArchiveError) -> None:
    _log.error("archive_failed", problem=str(error))


def _make_directory(directory: Path) -> None:
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(
            f"data_directory {directory} cannot be made ({error.strerror}); name another with "
            "--data"
        ) from None


def _host_and_port(address: str, default_port: int) -> tuple[str, int]:
    host, _, port = address.partition(":")
    if not host or (port and not (port.isdigit() and 0 < int(port) < 65536)):
        raise ConfigError(f"--ioc {address}: give sim, env, HOST or HOST:PORT")
    return host, int(port) if port else default_port


def _from_environment() -> dict[str, Any]:
    """Take the network from the EPICS_CA_… variables, as any other client would."""
    environment = os.environ
    auto = environment.get("EPICS_CA_AUTO_ADDR_LIST", "YES").upper() != "NO"
    return {
        "address_list": environment.get("EPICS_CA_ADDR_LIST", ""),
        "auto_address_list": auto,
        "server_port": int(environment.get("EPICS_CA_SERVER_PORT", "5064")),
    }


def _check_limits(config: AppConfig, drive_limits: np.ndarray, channels: Channels) -> None:
    """Refuse a limit of ours that lies beyond the drive limits of the machine."""
    limit = config.limits.setpoint
    beyond = np.flatnonzero((drive_limits[:, 0] > -limit) | (drive_limits[:, 1] < limit))
    if beyond.size:
        first = beyond[0]
        raise ConfigError(
            f"limits.setpoint is {limit} A, but {beyond.size} correctors have narrower drive "
            f"limits, {channels.setpoint_pvs[first]} for one: {drive_limits[first, 0]} to "
            f"{drive_limits[first, 1]} A; lower limits.setpoint"
        )
