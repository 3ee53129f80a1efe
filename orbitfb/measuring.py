"""The measurement of the response matrix from start to file: who may, where, what comes of it."""

import signal
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

import numpy as np

from orbitfb import __version__
from orbitfb.config import AppConfig
from orbitfb.control import Lock, ask, is_running
from orbitfb.core.clock import SystemClock
from orbitfb.core.errors import ConfigError, ControlError, MeasurementError, OwnershipError
from orbitfb.core.signals import Channels, Mask, Vector
from orbitfb.epics.machine import EpicsMachine
from orbitfb.learn.builders import first_policy
from orbitfb.maintenance import activate_stored, movable, open_store, sim_job
from orbitfb.measure.column import Table
from orbitfb.measure.journal import Journal
from orbitfb.measure.judging import Judgement, judge
from orbitfb.measure.measurement import Measurement, Result, conditions
from orbitfb.measure.mover import Mover, restore_persistently
from orbitfb.measure.response_file import adopted, read_response, write_response
from orbitfb.measure.watch import Watch
from orbitfb.own_ring import OwnRing
from orbitfb.physics.response import response
from orbitfb.policies.masking import mask_of
from orbitfb.startup import SIMULATED, check_limits, find_ring, make_directory, take_ring

Say = Callable[[str], None]
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
    """

    ioc: str
    out: Path | None = None
    fresh: bool = False
    restore: bool | None = None
    activate: bool = False


class StopRequests:
    """Take SIGINT, SIGTERM and SIGHUP for the wish to stop: the setpoints are put back first.

    However many come, each only says so again: a process that ended at the second would leave
    correctors where they are.

    Attributes:
        number: Of the first signal; 0: none came.
    """

    def __init__(self) -> None:
        self.number = 0

    def asked(self) -> bool:
        """Say whether one came."""
        return self.number != 0

    def _handle(self, number: int, _frame: object) -> None:
        self.number = self.number or number

    def __enter__(self) -> Self:
        """Take the signals."""
        numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        self._before = {number: signal.signal(number, self._handle) for number in numbers}
        return self

    def __exit__(self, *_: object) -> None:
        """Give them back."""
        for number, handler in self._before.items():
            signal.signal(number, handler)


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
    make_directory(config.data_directory)
    out = _place(config, request)
    clock = SystemClock()
    begin = clock.wall()
    with ExitStack() as stack:
        _be_alone(config, stack)
        if simulated:
            epics = OwnRing(sim_job(config), stack).settings(config)
            directory = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        else:
            directory = config.data_directory / "measurement"
        take_ring(epics, channels, stack)
        where = f"{epics.address_list}:{epics.server_port}"
        machine = EpicsMachine(channels, epics, clock)
        stack.callback(machine.close)
        check_limits(config, machine.drive_limits, channels)
        journal = Journal(directory, channels, where)
        timeout = max(1.0, 5.0 * config.loop.period)
        watch = Watch(machine, config.measure, config.interlocks, counting, timeout, stop.asked)
        _put_back(machine, journal, where, watch, config, request.restore, say, confirm)
        table = _taken_up(journal, channels, config, request.fresh, begin, say)
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
        )
        say(f"measuring {int(moving.sum())} correctors at {where}; Ctrl-C puts the setpoints back")
        result = measurement.run(table)
        judgement = judge(result.table, nominal, channels, config.measure, counting)
        about = _about(config, result, where, begin, clock.wall(), watch.rejected, channels)
        write_response(out, result.table, result.base, channels, judgement, about)
        journal.forget()
    answer = _answer(result, judgement, nominal, counting, out, about)
    if request.activate:
        answer |= _activate(config, out, channels, counting, moving)
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


def _put_back(
    machine: EpicsMachine,
    journal: Journal,
    where: str,
    watch: Watch,
    config: AppConfig,
    restore: bool | None,
    say: Say,
    confirm: Callable[[str], bool] | None,
) -> None:
    """Offer to put back what a killed measurement left astray."""
    moved = journal.moved()
    if moved is None:
        return
    pvs = machine.channels.setpoint_pvs
    if moved.where != where or not set(moved.setpoint_pvs) <= set(pvs):
        raise MeasurementError(
            f"a measurement at {moved.where} was killed and may have left setpoints astray "
            f"({', '.join(moved.setpoint_pvs[:3])}); first start it there again, in the same "
            f"planes, or put them back by hand and remove {journal.directory / 'moved.json'}"
        )
    mine = np.array([pvs.index(name) for name in moved.setpoint_pvs])
    mover = Mover(machine, config.limits, watch, config.measure.same_setpoint)
    away = np.abs(mover.base[mine] - moved.setpoints) > config.measure.same_setpoint
    if not away.any():
        journal.clear()
        return
    astray = "\n".join(
        f"  {pvs[mine[k]]}: {mover.base[mine[k]]:.6g} A, was {moved.setpoints[k]:.6g} A"
        for k in np.flatnonzero(away)[:10]
    )
    found = (
        f"a killed measurement of {datetime.fromtimestamp(moved.time, UTC):%Y-%m-%d %H:%M:%S} UTC "
        f"left {np.count_nonzero(away)} setpoints astray, the first ones:\n{astray}"
    )
    if restore is None and confirm is None:
        raise MeasurementError(
            f"{found}\nsay --restore to put them back, --leave to leave them as they are now"
        )
    if confirm is not None and restore is None:
        restore = confirm(f"{found}\nPut them back?")
    if restore:
        mover.base[mine] = moved.setpoints
        patience = config.measure.restore_timeout
        restore_persistently(mover, mine.tolist(), machine, SystemClock(), patience)
        say(f"{np.count_nonzero(away)} setpoints are back where the killed measurement found them")
    else:
        say(f"{np.count_nonzero(away)} setpoints stay as the killed measurement left them")
    journal.clear()


def _taken_up(
    journal: Journal, channels: Channels, config: AppConfig, fresh: bool, now: float, say: Say
) -> Table:
    """Take up what a measurement that was stopped has done."""
    if fresh:
        journal.forget()
    kept = journal.load(conditions(config.measure), now - config.measure.resume_within)
    if kept is None or not kept.measured.any():
        return Table.empty(len(channels.bpms), len(channels.correctors))
    since = datetime.fromtimestamp(float(np.nanmin(kept.time)), UTC)
    say(
        f"going on with the measurement of {since:%Y-%m-%d %H:%M} UTC: "
        f"{np.count_nonzero(kept.measured)} correctors are done (--fresh begins anew)"
    )
    return kept


def _progress(say: Say) -> Callable[[int, int], None]:
    told = -1

    def progress(done: int, total: int) -> None:
        nonlocal told
        part = done * _TOLD_TIMES // total
        if part > told:
            told = part
            say(f"{done} of {total} correctors are done")

    return progress


def _about(
    config: AppConfig,
    result: Result,
    where: str,
    begin: float,
    end: float,
    rejected: int,
    channels: Channels,
) -> dict[str, Any]:
    return {
        "created": end,
        "duration": end - begin,
        "ring": where,
        "method": "steps" if config.measure.at_once == 1 else "at once",
        "settings": config.measure.model_dump(mode="json"),
        "orbits_rejected": rejected,
        "check": {channels.setpoint_pvs[j]: apart for j, apart in result.check.items()},
        "version": __version__,
    }


def _answer(
    result: Result,
    judgement: Judgement,
    nominal: Vector,
    counting: Mask,
    out: Path,
    about: dict[str, Any],
) -> dict[str, Any]:
    """Say what came of it, for people and programs."""
    table = result.table
    area = np.isfinite(table.response) & counting[:, None]
    size = float(np.sqrt(np.mean(table.response[area] ** 2)))
    return {
        "file": str(out),
        "correctors": int(table.measured.sum()),
        "not_measured": len(judgement.missing),
        "bad_correctors": judgement.correctors,
        "bad_bpms": judgement.bpms,
        "uncertainty": float(np.sqrt(np.mean(table.sigma[area] ** 2))) / size,
        "noise_um": float(np.nanmedian(table.noise)) * 1e6,
        "from_optics": float(
            np.linalg.norm((table.response - nominal)[area]) / np.linalg.norm(nominal[area])
        ),
        "check": about["check"],
        "orbits_rejected": about["orbits_rejected"],
        "duration_s": about["duration"],
    }


def _activate(
    config: AppConfig, out: Path, channels: Channels, counting: Mask, moving: Mask
) -> dict[str, Any]:
    """Make a policy of a measured matrix and put it in force; refused if anything is bad."""
    matrix = adopted(read_response(out, channels), out, channels, counting, moving)
    policy = first_policy(matrix, config.policy, movable(config, config.ring.load()))
    stored = open_store(config).save(policy, channels, training={"measured": str(out)})
    return {"stored": stored, **activate_stored(config, policy.policy_id)}
