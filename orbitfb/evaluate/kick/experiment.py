"""Random kicks on the simulated ring, through Channel Access: the paper's machine experiment.

Soft IOC in a child process, runner, learner: the real loop, on a clock faster than the machine's.
The response of the ring differs from the controllers' by a stated amount. Every law gets a ring
of its own, with the same seed and so the same kicks; they are written to the ring's kick PV.
"""

import threading
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np

from orbitfb.core.refit import Decision, RefitReport
from orbitfb.core.signals import LoopState, TickRecord, Vector
from orbitfb.epics.orbit.snapshot import Snapshot
from orbitfb.epics.probe import Probe
from orbitfb.epics.settings import EpicsSettings
from orbitfb.evaluate.closed import accelerated, closed_loop
from orbitfb.evaluate.kick.figures import LATEST, Recovery, recoveries, recovery_figures
from orbitfb.evaluate.kick.laws import opening_policy, start_learner
from orbitfb.evaluate.kick.settings import KickSettings, Law, Responses, responses
from orbitfb.history.buffer import History
from orbitfb.loop.slot import PolicySlot
from orbitfb.physics.places import Ring
from orbitfb.sim.child import SimChild
from orbitfb.sim.job import SimJob
from orbitfb.sim.layout import KICK_PV, TICK_PV, TRUE_RMS_PV
from orbitfb.sim.settings import SimSettings

_MILLI = 1e3


@dataclass(frozen=True, slots=True)
class KickRun:
    """One law on its ring.

    Args:
        true_rms: Of the true orbit by tick of the ring, shape (ticks,) [m]; NaN before the first
            one that was seen and after the loop has tripped.
        recoveries: What followed every kick.
        missed: Orbits that the loop did not see.
        limited: Ticks whose change was shortened by the limits.
        state: State of the loop at the end.
        reason: Why.
        reports: What the learner did.
        ended: Tick of the ring at which the run ended.
        asked: How many kicks were asked for until then.
    """

    true_rms: Vector
    recoveries: tuple[Recovery, ...]
    missed: int
    limited: int
    state: LoopState
    reason: str
    reports: tuple[RefitReport, ...]
    ended: int = 0
    asked: int = 0

    def ending(self, planned: int) -> str:
        """Say how the run ended, and when if it was too early.

        Args:
            planned: How many kicks there should have been.
        """
        if self.state not in (LoopState.TRIPPED, LoopState.FAULT):
            return str(self.state)
        when = f"after {self.asked} of {planned} kicks" if self.asked else "before the first kick"
        return f"{self.state} at tick {self.ended}, {when}"

    def figures(self, planned: int) -> dict[str, float]:
        """Sum it up; see `orbitfb.evaluate.kick.figures.recovery_figures`.

        Args:
            planned: How many kicks there should have been.
        """
        decisions = [report.decision for report in self.reports]
        return (
            recovery_figures(self.recoveries, planned)
            | {"missed": float(self.missed), "limited": float(self.limited)}
            | {"kicks_asked": float(self.asked), "ended_at_tick": float(self.ended)}
            | {str(decision): float(decisions.count(decision)) for decision in Decision}
        )


@dataclass(frozen=True, slots=True)
class KickResult:
    """What came out.

    Args:
        settings: What was run.
        wrong: How wrong the controllers' response is.
        runs: By law.
    """

    settings: KickSettings
    wrong: Mapping[str, float]
    runs: Mapping[Law, KickRun]


def evaluate_kick(
    settings: KickSettings, progress: Callable[[str], None] = lambda _: None
) -> KickResult:
    """Run every law.

    Args:
        settings: What to run.
        progress: Told what begins.

    Raises:
        OrbitFeedbackError: The soft IOC could not be started or reached.
    """
    known = responses(settings)
    runs: dict[Law, KickRun] = {}
    for law in settings.laws:
        progress(f"{law}: {settings.ticks} ticks at {settings.rate_hz:g} Hz")
        with ExitStack() as stack:
            runs[law] = _Experiment(settings, known, law, stack).run()
    return KickResult(settings, known.figures(settings.policy.svd), runs)


class _Experiment:
    """Ring, loop and learner of one law."""

    def __init__(
        self, settings: KickSettings, known: Responses, law: Law, stack: ExitStack
    ) -> None:
        self._settings = settings
        self._done = threading.Event()
        self._missed = self._limited = 0
        self._tick = 0
        self._asked: list[int] = []
        self._true_rms = np.full(settings.ticks, np.nan)
        self._reports: list[RefitReport] = []
        child = stack.enter_context(SimChild(_job(settings)))
        network = EpicsSettings(server_port=child.port)
        channels = Ring.load().channels(settings.planes)
        slot = PolicySlot(opening_policy(law, settings, known))
        history = History(channels, 4000)
        self._runner = closed_loop(
            channels, network, slot, accelerated(settings.rate_hz), (history, self._note), stack
        )
        self._probe = stack.enter_context(
            Probe((TICK_PV, TRUE_RMS_PV), KICK_PV, network, self._see)
        )
        start_learner(
            law, settings, known, history, slot, self._reports.append, self._tripped, stack
        )

    def run(self) -> KickRun:
        self._runner.run(self._done)
        found = recoveries(self._true_rms, self._asked, self._settings.window - LATEST)
        return KickRun(
            self._true_rms,
            tuple(found),
            self._missed,
            self._limited,
            self._runner.state,
            self._runner.reason,
            tuple(self._reports),
            self._tick,
            len(self._asked),
        )

    def _tripped(self) -> bool:
        return self._runner.state is LoopState.TRIPPED

    def _note(self, record: TickRecord) -> None:
        """Take a record of the loop, and kick when it is time."""
        self._missed += record.missed
        self._limited += record.scale < 1.0
        if record.state is LoopState.TRIPPED:  # the beam is as good as lost: no more kicks
            self._done.set()
            return
        settings, number, tick = self._settings, len(self._asked), self._tick
        if number < settings.kicks and tick >= settings.settle + number * settings.window:
            self._asked.append(tick)
            self._probe.turn(settings.kick_rms * _MILLI)

    def _see(self, snapshot: Snapshot) -> None:
        """Take what the ring says of itself at a tick; ends the run after the last one."""
        number, true_rms = snapshot.values.tolist()
        if not (np.isfinite(number) and np.isfinite(true_rms)):
            return
        self._tick = int(number)
        if self._tick < len(self._true_rms):
            self._true_rms[self._tick] = true_rms / _MILLI
        else:
            self._done.set()


def _job(settings: KickSettings) -> SimJob:
    return SimJob(
        planes=settings.planes,
        seed=settings.seed,
        plant=settings.plant(),
        effects=settings.effects,
        sim=SimSettings(port=0, rate_hz=settings.rate_hz),
    )
