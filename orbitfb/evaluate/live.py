"""The learner in the real loop: soft IOC, Channel Access, runner, thread, on a drifting ring.

The clock is accelerated. Without a `rate_hz` ring and loop go in lockstep: the ring advances as
soon as all setpoints are written (and every two seconds while they are not), and the learner
looks on between two ticks, so that its arithmetic takes hardly any simulated time and a run says
the same on any computer. With a `rate_hz` both tick at that rate and the learner is a thread, as
in operation. Every law gets a ring of its own with the same seed, one after the other:

- `told`: the policy is rebuilt from the true R_t every few ticks, the bound (`informed`);
- `frozen`: keeps the R of the first tick, watched for a degradation that nobody acts upon;
- `ours`: the learner, with its judge, its trial in shadow and its roll-back.
"""

import multiprocessing
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.refit import Alarm, Decision, RefitReport
from orbitfb.core.signals import LoopState, TickRecord, Vector
from orbitfb.epics.settings import AuxiliarySettings, EpicsSettings
from orbitfb.evaluate.closed import accelerated, closed_loop
from orbitfb.evaluate.live_settings import LiveSettings, informed
from orbitfb.history.buffer import History
from orbitfb.learn.builders import ResponsePolicy, builder, first_policy
from orbitfb.learn.learner import Learner
from orbitfb.learn.trainer import InlineTrainer
from orbitfb.learn.worker import LearnerThread
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant
from orbitfb.sim.child import SimChild
from orbitfb.sim.job import SimJob
from orbitfb.sim.layout import TICK_PV, TRUE_RMS_PV
from orbitfb.sim.settings import SimSettings

LAWS = ("told", "frozen", "ours")
_TOLD_EVERY = 20
_LOST = 5e-3
"""What counts for the orbit after a trip, as in `orbitfb.evaluate.simulate` [m]."""
_STEP = 5
"""Ticks between two looks of the learner in lockstep: half a second of a loop at 10 Hz."""
_POLL = 0.02
_EFFECTS_PERIOD = 0.1
"""By which effects count time in lockstep: that of a loop at 10 Hz [s]."""

_LOCKSTEP_RING = SimSettings(port=0, lockstep=True, rate_hz=0.5)
_LOCKSTEP_LOOP = LoopSettings(rate_hz=1000.0, hold_after=9000.0, ramp=0.02)
"""Waits for a refit of several seconds, and takes every orbit of a ring in lockstep."""


@dataclass(frozen=True, slots=True)
class LiveRun:
    """One law on its ring.

    Args:
        true_rms: Of the true orbit by tick of the ring, shape (ticks,) [m]; NaN where the loop
            did not see the tick, 5 mm after a trip.
        missed: Orbits that the loop did not see.
        state: State of the loop at the end.
        reason: Why.
        reports: What the learner did.
        alarms: What it was alarmed by.
    """

    true_rms: Vector
    missed: int
    state: LoopState
    reason: str
    reports: tuple[RefitReport, ...]
    alarms: tuple[Alarm, ...] = ()

    def second_half(self) -> float:
        """True orbit over the second half of the run, rms [m]."""
        half = self.true_rms[len(self.true_rms) // 2 :]
        return float(np.sqrt(np.nanmean(half**2)))


def evaluate_live(
    each: Sequence[LiveSettings],
    progress: Callable[[str], None] = lambda _: None,
    at_once: int = 1,
) -> Iterator[tuple[LiveSettings, Mapping[str, LiveRun]]]:
    """Run every law.

    Args:
        each: What to run, a seed each.
        progress: Told what begins.
        at_once: Runs side by side, each in a process of its own; 1: one after the other, in this.

    Yields:
        What was run, and the run of every law, in the order of `each`.

    Raises:
        OrbitFeedbackError: The soft IOC could not be started or reached.
    """
    if at_once == 1:
        for settings in each:
            runs: dict[str, LiveRun] = {}
            for law in LAWS:
                progress(_words(settings, law))
                runs[law] = run_live(settings, law)
            yield settings, runs
        return
    spawning = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(at_once, mp_context=spawning) as pool:
        asked: list[dict[str, Future[LiveRun]]] = []
        for settings in each:
            progress(", ".join((_words(settings, LAWS[0]), *LAWS[1:])))
            asked.append({law: pool.submit(run_live, settings, law) for law in LAWS})
        for settings, futures in zip(each, asked, strict=True):
            yield settings, {law: future.result() for law, future in futures.items()}


def run_live(settings: LiveSettings, law: str) -> LiveRun:
    """Run one law on a ring of its own.

    Args:
        settings: What to run.
        law: One of `LAWS`.

    Raises:
        OrbitFeedbackError: The soft IOC could not be started or reached.
    """
    with ExitStack() as stack:
        return _Live(settings, law, stack).run()


def _words(settings: LiveSettings, law: str) -> str:
    return f"seed {settings.seed}, {settings.drift} drift: {law}"


def figures(runs: Mapping[str, LiveRun]) -> dict[str, float]:
    """Compare the laws: rms of the true orbit over the second half [m] and over that of `told`."""
    rms = {law: run.second_half() for law, run in runs.items()}
    decisions = [report.decision for report in runs["ours"].reports]
    return (
        {f"rms_{law}": value for law, value in rms.items()}
        | {f"rms_ratio_{law}": rms[law] / rms["told"] for law in ("frozen", "ours")}
        | {f"missed_{law}": float(run.missed) for law, run in runs.items()}
        | {str(decision): float(decisions.count(decision)) for decision in Decision}
        | {f"alarms_{law}": float(len(runs[law].alarms)) for law in ("frozen", "ours")}
        | {"first_alarm_frozen": _first_alarm(runs["frozen"])}
    )


def _first_alarm(run: LiveRun) -> float:
    """Tick of the first alarm; NaN when there was none."""
    return float(run.alarms[0].tick) if run.alarms else float("nan")


class _Live:
    """Ring, loop and learner of one law."""

    def __init__(self, settings: LiveSettings, law: str, stack: ExitStack) -> None:
        self._settings, self._law = settings, law
        self._done = threading.Event()
        self._tick = self._told = 0
        self._missed = 0
        self._true_rms = np.full(settings.ticks, np.nan)
        self._twin = Plant(Ring.load(), settings.planes, settings.plant(), settings.seed)
        job = SimJob(
            planes=settings.planes,
            seed=settings.seed,
            plant=settings.plant(),
            effects=settings.effects,
            period=1.0 / settings.rate_hz if settings.rate_hz else _EFFECTS_PERIOD,
            sim=_LOCKSTEP_RING
            if settings.rate_hz is None
            else SimSettings(port=0, rate_hz=settings.rate_hz),
        )
        child = stack.enter_context(SimChild(job))
        channels = self._twin.channels
        first = self._build(self._twin.response_at(0))
        self._slot = PolicySlot(first)
        self._history = History(channels, 4000)
        self._reports: list[RefitReport] = []
        self._alarms: list[Alarm] = []
        self._between: Callable[[], None] = lambda: None
        rate = settings.rate_hz
        loop = _LOCKSTEP_LOOP if rate is None else accelerated(rate)
        self._runner = closed_loop(
            channels, _network(child.port), self._slot, loop, (self._note,), stack
        )
        if law == "told":
            self._begin(self._tell, stack)
        else:
            self._begin(self._learner(first.response).step, stack)

    def run(self) -> LiveRun:
        self._runner.run(self._done)
        runner = self._runner
        return LiveRun(
            self._true_rms,
            self._missed,
            runner.state,
            runner.reason,
            tuple(self._reports),
            tuple(self._alarms),
        )

    def _build(self, response: Vector) -> ResponsePolicy:
        policy = self._settings.policy
        return first_policy(response, informed(policy) if self._law == "told" else policy)

    def _learner(self, response: Vector) -> LearnerThread:
        """Make the learner; beside a frozen law it only watches."""
        learn = self._settings.learn.model_copy(update={"enabled": self._law == "ours"})
        build = builder(self._settings.policy, seed=self._settings.seed)
        learner = Learner(response, learn, build, seed=self._settings.seed)
        return LearnerThread(
            InlineTrainer(learner),
            self._history,
            self._slot,
            self._reports.append,
            alarmed=self._alarms.append,
            tripped=lambda: self._runner.state is LoopState.TRIPPED,
        )

    def _begin(self, work: Callable[[], None], stack: ExitStack) -> None:
        """Let work be done beside the loop: between two ticks, or in a thread."""
        if self._settings.rate_hz is None:
            self._between = work
            return

        def repeat() -> None:
            while not self._done.wait(_POLL):
                work()

        thread = threading.Thread(target=repeat, name=self._law)
        thread.start()
        stack.callback(thread.join)
        stack.callback(self._done.set)

    def _note(self, record: TickRecord) -> None:
        """Take a record; ends the run when the ring has made all its ticks, or the loop tripped."""
        if record.state in (LoopState.TRIPPED, LoopState.FAULT):
            self._true_rms[self._tick :] = _LOST
            self._done.set()
        tick = np.nan if record.reading is None else record.reading.auxiliary["tick"]
        if record.reading is None or not np.isfinite(tick):
            self._history(record)
            return
        before, self._tick = self._tick, int(tick)
        # The ring says how many of its orbits the loop did not see; in lockstep no clock does.
        missed = max(self._tick - before - 1, 0)
        written = record.written
        if self._settings.rate_hz is None and np.isfinite(written):
            # The ring goes on when it has all setpoints, which may be before the loop knows that
            # the last one has left; they are in force at its next tick all the same.
            written = min(written, record.reading.orbit.time)
        self._history(replace(record, missed=missed, written=written))
        self._missed += missed
        if self._tick < len(self._true_rms):
            self._true_rms[self._tick] = record.reading.auxiliary["true_orbit_rms"]
        else:
            self._done.set()
        if self._tick % _STEP == 0:
            self._between()

    def _tell(self) -> None:
        """Keep the policy true to the ring."""
        if self._tick - self._told >= _TOLD_EVERY:
            self._told = self._tick
            self._slot.swap(self._build(self._twin.response_at(self._told)))


def _network(port: int) -> EpicsSettings:
    settings = EpicsSettings(server_port=port)
    simulated = {
        "true_orbit_rms": AuxiliarySettings(pv=TRUE_RMS_PV, scale=1e-3),
        "tick": AuxiliarySettings(pv=TICK_PV),
    }
    return settings.model_copy(update={"auxiliary": {**settings.auxiliary, **simulated}})
