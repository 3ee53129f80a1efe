"""The measurement of the response matrix from start to file: who may, where, what comes of it."""

import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import structlog

from orbitfb.app.measure.stopping import StopRequests
from orbitfb.app.response.answer import activate
from orbitfb.app.response.procedure import Choice, Subject, measure_on, place_of
from orbitfb.app.response.unfinished import Say
from orbitfb.app.setup.lease import take_lease
from orbitfb.app.setup.loop_in_force import loop_of
from orbitfb.app.setup.production_guard import check_live, pvs_of
from orbitfb.app.setup.simulated_ring import SimulatedRing
from orbitfb.app.setup.startup import SIMULATED, find_ring, make_directory, take_ring
from orbitfb.app.setup.stored_policies import sim_job
from orbitfb.config.tree import AppConfig
from orbitfb.control.client import ask, is_running
from orbitfb.core.clock import SystemClock
from orbitfb.core.errors import ControlError, OrbitFeedbackError, OwnershipError
from orbitfb.core.files.ownership import Lock
from orbitfb.epics.machine import EpicsMachine
from orbitfb.loop.machines.guarded import GuardedMachine
from orbitfb.loop.machines.stepped import stepped
from orbitfb.measure.left import DIRECTORY
from orbitfb.measure.measurement import Teller
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
    loop = loop_of(config, ring)
    simulated = request.ioc == SIMULATED
    epics = find_ring(config, request.ioc)
    check_live(epics, request.ioc, None, request.live, pvs_of(config))
    make_directory(config.data_directory)
    out = place_of(config, request.out)
    clock = SystemClock()
    with ExitStack() as stack:
        _be_alone(config, stack)
        if simulated:
            epics = SimulatedRing(sim_job(config), stack).settings(config)
            directory = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        else:
            directory = config.data_directory / DIRECTORY
        take_ring(epics, channels, stack)
        where = f"{epics.searched}:{epics.server_port}"
        logs = configure_logs(config.observe.logs, config.data_directory)
        stack.callback(logs.close)
        ring_machine = EpicsMachine(channels, epics, clock)
        stack.callback(ring_machine.close)
        drive = ring_machine.drive_limits
        bounds = Bounds.of(config.limits.setpoint, len(channels.correctors), drive)
        machine = stepped(
            ring_machine,
            ring_machine.steps,
            config.limits.setpoint,
            lambda: ring_machine.drive_limits,
        )
        lease = take_lease(config, epics, _lease_lost, stack)
        if lease is not None:
            machine = GuardedMachine(machine, lease.refusal)
        subject = Subject(
            config, machine, nominal, counting, moving, bounds, where, directory, clock, loop
        )
        choice = Choice(out, request.fresh, request.restore)
        try:
            answer = measure_on(subject, choice, stop.asked, _Saying(say, where), say, confirm)
        except OrbitFeedbackError as error:
            _log.warning("response_measurement_ended", problem=str(error))
            raise
        bad = len(answer["bad_correctors"])
        _log.info("response_measured", file=str(out), bad_correctors=bad)
    if request.activate:
        answer |= activate(config, out, channels, counting, moving)
    return answer


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


class _Saying(Teller):
    """Says now and then how far it is.

    Args:
        say: Told in words.
        where: The ring.
    """

    def __init__(self, say: Say, where: str) -> None:
        self._say, self._where = say, where
        self._correctors, self._waveform = -1, 0

    def begin(self, orbits: int, done: int, total: int) -> None:
        """Take how many correctors it is about."""
        self._say(f"measuring {total} correctors at {self._where}; Ctrl-C puts the setpoints back")
        _log.info("response_measurement_started", ring=self._where, correctors=total)

    def progress(self, done: int, total: int) -> None:
        """Take how many of how many correctors are done."""
        part = done * _TOLD_TIMES // total
        if part > self._correctors:
            self._correctors = part
            self._say(f"{done} of {total} correctors are done")

    def played(self, share: float) -> None:
        """Take which share of the waveform of a group at once is over."""
        part = int(share * _TOLD_TIMES)
        if 0 < part < _TOLD_TIMES and part != self._waveform:
            self._waveform = part
            self._say(f"{part / _TOLD_TIMES:.0%} of the waveform is played")


def _lease_lost(owner: str) -> None:
    """Log it; the guard refuses the next write, and with it the measurement ends."""
    _log.error("lease_lost", owner=owner)
