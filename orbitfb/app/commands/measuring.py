"""The measurement of the response in a running loop: started, looked at, aborted by command."""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import structlog

from orbitfb.app.commands.known_response import KnownResponse
from orbitfb.app.commands.preview import Handler
from orbitfb.app.response.answer import offered
from orbitfb.app.response.procedure import Choice, Subject, measure_on, place_of
from orbitfb.config.tree import AppConfig
from orbitfb.core.errors import ControlError, OrbitFeedbackError, StoppedError
from orbitfb.core.ports import Clock
from orbitfb.core.signals import Mask
from orbitfb.loop.lending.lent import LentMachine
from orbitfb.loop.runner import Runner
from orbitfb.loop.slot import PolicySlot
from orbitfb.measure.growth import Loop
from orbitfb.measure.journal import Journal
from orbitfb.measure.measurement import Teller
from orbitfb.measure.progress import Progress, Stage, progress_of
from orbitfb.measure.response_file import read_response
from orbitfb.observe.statistics.running import LoopStatistics
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.safety.bounds import Bounds

_log = structlog.stdlib.get_logger("orbitfb.control.socket")

NAME = "measurement of the response"
ACTIONS = ("status", "start", "abort")
ANSWER = 10.0
"""How long the answer to start waits until it is sure that nothing refuses it, and that to abort
until the setpoints are back [s]."""
_OPTIONS = {
    "--restore": "restore=true",
    "--leave": "restore=false",
    "--fresh": "fresh=true",
    "--at-once 1": "at_once=1",
}


@dataclass(frozen=True, slots=True)
class Sources:
    """What a measurement needs of the service.

    Args:
        config: How to measure, and where to.
        ring: The ring.
        runner: The loop.
        counting: BPMs that are not masked by configuration, shape (n,).
        movable: Gives the correctors that may move now, shape (m,).
        bounds: Gives the limits of the setpoints that are in force.
        where: The machine, as the journal calls it.
        journal: Directory of the journal.
        clock: Of the service.
        slot: The policy in force.
        measured: Takes what was measured; the loop does not close on what loses the beam there.
    """

    config: AppConfig
    ring: Ring
    runner: Runner
    counting: Mask
    movable: Callable[[], Mask]
    bounds: Callable[[], Bounds]
    where: str
    journal: Path
    clock: Clock
    slot: PolicySlot
    measured: KnownResponse


class Measuring(Teller):
    """Measures in a thread of its own with the machine that the loop lends it.

    Args:
        sources: What it needs.
        statistics: Gets a line for people.
    """

    def __init__(self, sources: Sources, statistics: LoopStatistics) -> None:
        self._sources, self._statistics = sources, statistics
        self._lock = threading.Lock()
        self._progress = Progress()
        self._thread: threading.Thread | None = None
        self._lent: LentMachine | None = None
        self._sure, self._stop = threading.Event(), threading.Event()
        self._planned, self._first, self._since = 0, 0, 0.0
        self._answer: Mapping[str, Any] = {}

    @property
    def handlers(self) -> dict[str, Handler]:
        """The commands by name."""
        return {"measure": self._measure}

    @property
    def sight(self) -> Progress:
        """How far it is; any thread may ask."""
        progress, lent = self._progress, self._lent
        if not progress.running or lent is None:
            return progress
        seen, clock = lent.orbits - self._first, self._sources.clock
        elapsed, period = clock.monotonic() - self._since, self._sources.config.loop.period
        share, left = progress_of(seen, self._planned, elapsed, period)
        return replace(progress, share=share, left=left)

    def shown(self) -> dict[str, Any]:
        """Give how far it is, by PV of the panel, in its units."""
        sight = self.sight
        return {
            "MeasureState-I": sight.stage.value,
            "MeasureDone-I": sight.done,
            "MeasureTotal-I": sight.total,
            "MeasureShare-I": 100.0 * sight.share,
            "MeasureLeft-I": sight.left,
            "MeasureText-I": sight.text,
        }

    def close(self) -> None:
        """Wait for the end; the loop has called its machine back."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join(self._sources.config.measure.restore_timeout + ANSWER)

    def begin(self, orbits: int, done: int, total: int) -> None:
        """Take how many orbits it needs, and how many correctors are done."""
        lent, sources = self._lent, self._sources
        self._planned, self._since = orbits, sources.clock.monotonic()
        self._first = 0 if lent is None else lent.orbits
        period = sources.config.loop.period
        told = f"{total - done} of {total} correctors, about {orbits * period:.0f} s"
        self._progress = replace(self._progress, done=done, total=total, text=told)
        self._sure.set()
        _log.info("response_measurement_started", ring=sources.where, correctors=total - done)
        self._statistics.happened("measurement", f"started: {told}")

    def progress(self, done: int, total: int) -> None:
        """Take how many of how many correctors are done."""
        self._progress = replace(self._progress, done=done, total=total)

    def _measure(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        action = request.get("action", ACTIONS[0])
        if action not in ACTIONS:
            raise ControlError(f"action must be {', '.join(ACTIONS)}, not {action!r}")
        if action != "start" and (more := {*request} & {"fresh", "restore", "at_once"}):
            raise ControlError(f"{', '.join(sorted(more))} goes with action=start only")
        if action == "start":
            return self._start(request)
        return self._abort() if action == "abort" else self._told()

    def _told(self) -> dict[str, Any]:
        sight = self.sight
        return {
            "state": sight.stage.value,
            "correctors_done": sight.done,
            "correctors": sight.total,
            "share": round(sight.share, 4),
            "seconds_left": round(sight.left, 1),
            "text": sight.text,
            **self._answer,
        }

    def _start(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        sources, config = self._sources, self._sources.config
        fresh, restore = request.get("fresh", False), request.get("restore")
        if not isinstance(fresh, bool) or not (restore is None or isinstance(restore, bool)):
            raise ControlError("fresh and restore must be true or false")
        at_once = request.get("at_once", config.measure.at_once)
        if not isinstance(at_once, int) or isinstance(at_once, bool) or at_once < 0:
            raise ControlError(f"at_once must be a count of correctors, not {at_once!r}")
        measure = config.measure.model_copy(update={"at_once": at_once})
        choice = Choice(place_of(config, None), fresh, restore)
        nominal = response(sources.ring, config.ring.planes)
        policy = sources.slot.current
        with self._lock:
            moving, bounds = sources.movable(), sources.bounds()
            lent = sources.runner.lend(NAME, moving)
            subject = Subject(
                config.model_copy(update={"measure": measure}),
                lent,
                nominal,
                sources.counting,
                moving,
                bounds,
                sources.where,
                sources.journal,
                sources.clock,
                Loop(policy, f"policy {policy.policy_id}, which is in force,"),
            )
            self._stop.clear()
            self._sure.clear()
            self._answer, self._lent, self._planned = {}, lent, 0
            self._progress = Progress(Stage.MEASURING, 0, int(moving.sum()), text="begins")
            self._thread = threading.Thread(
                target=self._run, args=(subject, choice, lent), name="measure", daemon=True
            )
            self._thread.start()
        self._sure.wait(ANSWER)
        if self._progress.stage is Stage.FAILED:
            raise ControlError(f"{NAME} refused: {self._progress.text}")
        return self._told()

    def _abort(self) -> Mapping[str, Any]:
        thread = self._thread
        if not self._progress.running or thread is None:
            raise ControlError("nothing is being measured")
        self._progress = replace(self._progress, stage=Stage.PUTTING_BACK, text="aborted")
        self._stop.set()
        thread.join(ANSWER)
        return self._told()

    def _run(self, subject: Subject, choice: Choice, lent: LentMachine) -> None:
        """Measure; give the machine back whatever happens, then say what came of it."""
        answer: dict[str, Any] | None = None
        stage, told = Stage.FAILED, ""
        try:
            answer = measure_on(subject, choice, self._stop.is_set, self, self._note)
        except StoppedError:
            stage = Stage.ABORTED
            told = "aborted; what is done is kept: start goes on with it (fresh=true starts again)"
        except OrbitFeedbackError as error:
            told = _as_command(str(error))
        except Exception as error:  # the setpoints are back; the loop goes on
            _log.exception("response_measurement_failed")
            told = f"the program failed: {type(error).__name__}: {error}"
        finally:
            self._progress = replace(self._progress, stage=Stage.PUTTING_BACK)
            lent.close()
        if answer is not None:
            stage = Stage.DONE
            try:
                self._take(subject, Path(answer["file"]))
                more, told = offered(subject.config, answer, lent.channels)
                self._answer = {**answer, **more}
            except OrbitFeedbackError as error:
                self._answer, told = answer, f"{answer['file']} is written; no policy yet: {error}"
        elif self._sure.is_set() and _is_back(subject):
            told = f"{told}; the setpoints are back"
        self._end(stage, told)

    def _take(self, subject: Subject, out: Path) -> None:
        measured = read_response(out, subject.machine.channels)
        known = self._sources.measured
        known.take(measured, subject.nominal, subject.counting, subject.moving)

    def _end(self, stage: Stage, told: str) -> None:
        self._progress = replace(self.sight, stage=stage, left=0.0, text=told)
        self._sure.set()
        if stage is Stage.DONE:
            _log.info("response_measured", told=told)
        else:
            _log.warning("response_measurement_ended", problem=told)
        self._statistics.happened("measurement", told)

    def _note(self, line: str) -> None:
        """Take what was found at the start."""
        line = _as_command(line)
        self._progress = replace(self._progress, text=line)
        self._statistics.happened("measurement", line)


def _as_command(text: str) -> str:
    """Name options as this command has them, not as `orbitfb measure-response`."""
    for option, key in _OPTIONS.items():
        text = text.replace(option, key)
    return text


def _is_back(subject: Subject) -> bool:
    """Whether nothing is left astray, by the journal."""
    journal = Journal(subject.directory, subject.machine.channels, subject.where)
    try:
        return journal.moved() is None
    except OrbitFeedbackError:
        return False
