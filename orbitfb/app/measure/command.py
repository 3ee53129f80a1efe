"""The measurement of the response matrix from start to file: who may, where, what comes of it."""

import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import structlog

from orbitfb.app.measure.answer import about_of, activate, answer_of
from orbitfb.app.measure.stopping import StopRequests
from orbitfb.app.measure.unfinished import Say, put_back, taken_up
from orbitfb.app.setup.lease import take_lease
from orbitfb.app.setup.production_guard import check_live
from orbitfb.app.setup.simulated_ring import SimulatedRing
from orbitfb.app.setup.startup import SIMULATED, find_ring, make_directory, take_ring
from orbitfb.app.setup.stored_policies import sim_job
from orbitfb.config.tree import AppConfig
from orbitfb.control.socket import ask, is_running
from orbitfb.core.clock import SystemClock
from orbitfb.core.errors import ConfigError, ControlError, OrbitFeedbackError, OwnershipError
from orbitfb.core.files.ownership import Lock
from orbitfb.core.ports import Machine
from orbitfb.epics.machine import EpicsMachine
from orbitfb.loop.machines.guarded import GuardedMachine
from orbitfb.measure.journal import Journal
from orbitfb.measure.judging import judge
from orbitfb.measure.left import DIRECTORY
from orbitfb.measure.measurement import Measurement
from orbitfb.measure.response_file import write_response
from orbitfb.measure.watch import Watch
from orbitfb.observe.logs import configure_logs
from orbitfb.physics.response import response
from orbitfb.policies.masking import mask_of
from orbitfb.safety.bounds import Bounds

_log = structlog.stdlib.get_logger("orbitfb.measure")
_TOLD_TIMES = 20


@dataclass(frozen=True, slots=True)
class MeasureRequest:
    """What is asked for.

    Args:
        ioc: `sim`, `env`, `config` or `HOST[:PORT]`.
        out: File of the matrix; None: a name with the time in the data directory.
        fresh: Drop the columns of a measurement that was stopped.
        restore: What to do with setpoints that a killed measurement left astray: put them back,
            leave them; None: ask.
        activate: Make a policy of the matrix and put it in force.
        live: Whether the port of production is meant.
    """

    ioc: str
    out: Path | None = None
    fresh: bool = False
    restore: bool | None = None
    activate: bool = False
    live: bool = False


def measure_response(
    config: AppConfig,
    request: MeasureRequest,
    stop: StopRequests,
    say: Say = lambda _: None,
    confirm: Callable[[str], bool] | None = None,
) -> dict[str, Any]:
    """Measure the response matrix and write it.

    Args:
        config: The configuration.
        request: What is asked for.
        stop: Says when to stop.
        say: Told how far it is.
        confirm: Asks somebody a question; None: nobody is there.

    Returns:
        What came of it.

    Raises:
        StoppedError: Somebody stopped it; the setpoints are back, the columns are kept.
        OrbitFeedbackError: It was refused, or given up.
    """
    ring = config.ring.load()
    channels = ring.channels(config.ring.planes)
    counting, moving = mask_of(channels, config.masks)
    nominal = response(ring, config.ring.planes)
    simulated = request.ioc == SIMULATED
    epics = find_ring(config, request.ioc)
    check_live(epics, request.ioc, None, request.live)
    make_directory(config.data_directory)
    out = _place(config, request)
    clock = SystemClock()
    begin = clock.wall()
    with ExitStack() as stack:
        _be_alone(config, stack)
        if simulated:
            epics = SimulatedRing(sim_job(config), stack).settings(config)
            directory = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        else:
            directory = config.data_directory / DIRECTORY
        take_ring(epics, channels, stack)
        where = f"{epics.address_list}:{epics.server_port}"
        logs = configure_logs(config.observe.logs, config.data_directory)
        stack.callback(logs.close)
        ring_machine = EpicsMachine(channels, epics, clock)
        stack.callback(ring_machine.close)
        drive = ring_machine.drive_limits
        bounds = Bounds.of(config.limits.setpoint, len(channels.correctors), drive)
        machine: Machine = ring_machine
        lease = take_lease(config, epics, _lease_lost, stack)
        if lease is not None:
            machine = GuardedMachine(machine, lease.refusal)
        journal = Journal(directory, channels, where)
        timeout = max(1.0, 5.0 * config.loop.period)
        watch = Watch(machine, config.measure, config.interlocks, counting, timeout, stop.asked)
        put_back(
            machine, nominal, journal, where, watch, config, request.restore, say, confirm, bounds
        )
        table = taken_up(journal, channels, config, request.fresh, begin, say)
        measurement = Measurement(
            machine,
            nominal,
            config.measure,
            config.limits,
            watch,
            moving,
            journal,
            clock,
            config.seed,
            _progress(say),
            bounds,
            _waveform(say),
        )
        say(f"measuring {int(moving.sum())} correctors at {where}; Ctrl-C puts the setpoints back")
        _log.info("response_measurement_started", ring=where, correctors=int(moving.sum()))
        try:
            result = measurement.run(table)
        except OrbitFeedbackError as error:
            _log.warning("response_measurement_ended", problem=str(error))
            raise
        judgement = judge(result.table, nominal, channels, config.measure, counting)
        about = about_of(config, result, where, begin, clock.wall(), watch.rejected, channels)
        write_response(out, result.table, result.base, channels, judgement, about)
        journal.forget()
        _log.info("response_measured", file=str(out), bad_correctors=len(judgement.correctors))
    answer = answer_of(result, judgement, nominal, counting, out, about, channels)
    if request.activate:
        answer |= activate(config, out, channels, counting, moving)
    return answer


def _place(config: AppConfig, request: MeasureRequest) -> Path:
    """See beforehand that the file can be written."""
    name = f"response-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.safetensors"
    out = request.out or config.data_directory / name
    try:
        with tempfile.TemporaryFile(dir=out.parent):
            pass
    except OSError as error:
        raise ConfigError(
            f"--out {out}: its directory cannot be written to ({error.strerror}); name another"
        ) from error
    if out.is_dir():
        raise ConfigError(f"--out {out}: that is a directory; name a file")
    return out


def _be_alone(config: AppConfig, stack: ExitStack) -> None:
    """Refuse beside a service of this data directory."""
    directory = config.data_directory
    if is_running(directory):
        try:
            state = ask(directory, {"command": "status"})["state"]
        except ControlError:
            state = "running"
        raise OwnershipError(
            f"a service on the data directory {directory} is {state}: its loop would correct what "
            "is measured; stop it first, then measure"
        )
    stack.enter_context(
        Lock(
            f"data {directory.resolve()}",
            f"the data directory {directory}",
            "stop it, or name another directory with --data",
        )
    )


def _progress(say: Say) -> Callable[[int, int], None]:
    told = -1

    def progress(done: int, total: int) -> None:
        nonlocal told
        part = done * _TOLD_TIMES // total
        if part > told:
            told = part
            say(f"{done} of {total} correctors are done")

    return progress


def _waveform(say: Say) -> Callable[[float], None]:
    told = 0

    def played(share: float) -> None:
        nonlocal told
        part = int(share * _TOLD_TIMES)
        if 0 < part < _TOLD_TIMES and part != told:
            told = part
            say(f"{part / _TOLD_TIMES:.0%} of the waveform is played")

    return played


def _lease_lost(owner: str) -> None:
    """Log it; the guard refuses the next write, and with it the measurement ends."""
    _log.error("lease_lost", owner=owner)
