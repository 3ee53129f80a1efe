"""The measurement of the response matrix on a machine at hand, from what was left to the file."""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from orbitfb.app.response.answer import about_of, answer_of
from orbitfb.app.response.unfinished import Say, put_back, taken_up
from orbitfb.config.tree import AppConfig
from orbitfb.core.errors import ConfigError
from orbitfb.core.ports import Clock, Machine
from orbitfb.core.signals import Mask
from orbitfb.measure.growth import Loop
from orbitfb.measure.journal import Journal
from orbitfb.measure.judging import judge
from orbitfb.measure.measurement import Measurement, Teller
from orbitfb.measure.response_file import write_response
from orbitfb.measure.watch import Watch
from orbitfb.physics.optics import Matrix
from orbitfb.safety.bounds import Bounds


@dataclass(frozen=True, slots=True)
class Subject:
    """What is measured.

    Args:
        config: How.
        machine: The ring.
        nominal: Response by the optics, shape (n, m) [m/A].
        counting: BPMs that are not masked, shape (n,).
        moving: Correctors to measure, shape (m,).
        bounds: Where the setpoint of each may be.
        where: The ring, as the journal calls it.
        directory: Of the journal.
        clock: Tells the time.
        loop: The loop that would be closed on what is measured.
    """

    config: AppConfig
    machine: Machine
    nominal: Matrix
    counting: Mask
    moving: Mask
    bounds: Bounds
    where: str
    directory: Path
    clock: Clock
    loop: Loop


@dataclass(frozen=True, slots=True)
class Choice:
    """What is asked for.

    Args:
        out: File of the matrix.
        fresh: Drop the columns of a measurement that was stopped.
        restore: What to do with setpoints that a killed measurement left astray: put them back,
            leave them; None: ask.
    """

    out: Path
    fresh: bool = False
    restore: bool | None = None


def place_of(config: AppConfig, out: Path | None) -> Path:
    """Say where the matrix goes, and see beforehand that it can be written there.

    Args:
        config: Names the data directory.
        out: Where somebody wants it; None: a name with the time in the data directory.

    Raises:
        ConfigError: It cannot.
    """
    name = f"response-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.safetensors"
    out = out or config.data_directory / name
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


def measure_on(
    subject: Subject,
    choice: Choice,
    stopped: Callable[[], bool],
    teller: Teller,
    say: Say,
    confirm: Callable[[str], bool] | None = None,
) -> dict[str, Any]:
    """Measure and write the file; the setpoints are put back on every way out.

    Args:
        subject: What is measured.
        choice: What is asked for.
        stopped: Asked before every orbit.
        teller: Told how far it is.
        say: Told in words what was found at the start.
        confirm: Asks somebody a question; None: nobody is there.

    Returns:
        What came of it.

    Raises:
        StoppedError: Somebody stopped it; the setpoints are back, the columns are kept.
        OrbitFeedbackError: It was refused, or given up.
    """
    config, machine, clock = subject.config, subject.machine, subject.clock
    channels, begin = machine.channels, clock.wall()
    journal = Journal(subject.directory, channels, subject.where)
    timeout = max(1.0, 5.0 * config.loop.period)
    settings, interlocks = config.measure, config.interlocks
    watch = Watch(machine, settings, interlocks, subject.counting, timeout, stopped)
    put_back(
        machine,
        subject.nominal,
        journal,
        subject.where,
        watch,
        config,
        choice.restore,
        say,
        confirm,
        subject.bounds,
    )
    table = taken_up(journal, channels, config, choice.fresh, begin, say)
    measurement = Measurement(
        machine,
        subject.nominal,
        settings,
        config.limits,
        watch,
        subject.moving,
        journal,
        clock,
        config.seed,
        subject.bounds,
        teller,
    )
    result = measurement.run(table)
    judgement = judge(result.table, subject.nominal, channels, settings, subject.counting)
    end, rejected = clock.wall(), watch.rejected
    about = about_of(config, result, subject.where, begin, end, rejected, channels)
    write_response(choice.out, result.table, result.base, channels, judgement, about)
    journal.forget()
    return answer_of(
        result, judgement, subject.nominal, subject.counting, choice.out, about, channels,
        subject.loop,
    )  # fmt: skip
