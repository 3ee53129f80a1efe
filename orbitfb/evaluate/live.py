"""The learner in the real loop: soft IOC, Channel Access, runner, thread, on a drifting ring.

The clock is accelerated: ring and loop tick at `rate_hz` instead of 10 Hz. Every law gets a ring
of its own with the same seed, one after the other:

- `told`: the policy is rebuilt from the true R_t every few ticks, the bound;
- `frozen`: keeps the R of the first tick;
- `ours`: the learner's thread, with its judge and its roll-back.
"""

import threading
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from orbitfb.core.clock import SystemClock
from orbitfb.core.refit import Decision, RefitReport
from orbitfb.core.settings import Settings
from orbitfb.core.signals import LoopState, TickRecord, Vector
from orbitfb.epics.machine import EpicsMachine
from orbitfb.epics.settings import AuxiliarySettings, EpicsSettings
from orbitfb.history.buffer import History
from orbitfb.learn.builders import builder
from orbitfb.learn.learner import Learner
from orbitfb.learn.settings import LearnSettings
from orbitfb.learn.trainer import InlineTrainer
from orbitfb.learn.worker import LearnerThread
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.physics.drift import DriftSettings, Preset
from orbitfb.physics.places import Planes, Ring
from orbitfb.physics.plant import Plant, PlantSettings
from orbitfb.policies.settings import PolicySettings
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings
from orbitfb.sim.child import SimChild
from orbitfb.sim.job import SimJob
from orbitfb.sim.layout import TICK_PV, TRUE_RMS_PV
from orbitfb.sim.settings import SimSettings

LAWS = ("told", "frozen", "ours")
_TOLD_EVERY = 20
_POLL = 0.02
_SLACK = 0.3
"""How long the loop waits for an orbit before it holds [s]: the clock is the computer's own."""


class LiveSettings(Settings):
    """What to run."""

    drift: Preset = Field(default="strong", description="Drift of the ring over the whole run.")
    ticks: int = Field(default=6000, ge=200, description="Length of each run [ticks].")
    seed: int = Field(default=1, ge=0, description="Seed of ring, noise and drift.")
    planes: Planes = Field(default="x", description="Planes under feedback.")
    rate_hz: float = Field(default=200.0, gt=0, le=500, description="Ticks per second [Hz].")
    policy: SvdSettings = Field(default=SvdSettings(), description="Gain and λ of all the laws.")
    learn: LearnSettings = Field(default=LearnSettings(), description="The learner.")

    def plant(self) -> PlantSettings:
        """Return what the ring suffers from."""
        if self.drift == "none":
            return PlantSettings()
        drift = {"preset": self.drift, "ticks": self.ticks}
        return PlantSettings(drift=DriftSettings.model_validate(drift))


@dataclass(frozen=True, slots=True)
class LiveRun:
    """One law on its ring.

    Args:
        true_rms: Of the true orbit by tick of the ring, shape (ticks,) [m]; NaN where the loop
            did not see the tick.
        missed: Orbits that the loop did not see.
        state: State of the loop at the end.
        reason: Why.
        reports: What the learner did.
    """

    true_rms: Vector
    missed: int
    state: LoopState
    reason: str
    reports: tuple[RefitReport, ...]

    def second_half(self) -> float:
        """True orbit over the second half of the run, rms [m]."""
        half = self.true_rms[len(self.true_rms) // 2 :]
        return float(np.sqrt(np.nanmean(half**2)))


def evaluate_live(
    settings: LiveSettings, progress: Callable[[str], None] = lambda _: None
) -> Mapping[str, LiveRun]:
    """Run every law.

    Args:
        settings: What to run.
        progress: Told what begins.

    Raises:
        OrbitFeedbackError: The soft IOC could not be started or reached.
    """
    runs: dict[str, LiveRun] = {}
    for law in LAWS:
        progress(f"seed {settings.seed}, {settings.drift} drift: {law}")
        with ExitStack() as stack:
            runs[law] = _Live(settings, law, stack).run()
    return runs


def figures(runs: Mapping[str, LiveRun]) -> dict[str, float]:
    """Compare the laws: rms of the true orbit over the second half [m] and over that of `told`."""
    rms = {law: run.second_half() for law, run in runs.items()}
    decisions = [report.decision for report in runs["ours"].reports]
    return (
        {f"rms_{law}": value for law, value in rms.items()}
        | {f"rms_ratio_{law}": rms[law] / rms["told"] for law in ("frozen", "ours")}
        | {f"missed_{law}": float(run.missed) for law, run in runs.items()}
        | {str(decision): float(decisions.count(decision)) for decision in Decision}
    )


class _Live:
    """Ring, loop and learner of one law."""

    def __init__(self, settings: LiveSettings, law: str, stack: ExitStack) -> None:
        self._settings, self._law = settings, law
        self._done = threading.Event()
        self._tick = 0
        self._missed = 0
        self._true_rms = np.full(settings.ticks, np.nan)
        self._twin = Plant(Ring.load(), settings.planes, settings.plant(), settings.seed)
        job = SimJob(
            planes=settings.planes,
            seed=settings.seed,
            plant=settings.plant(),
            sim=SimSettings(port=0, rate_hz=settings.rate_hz),
        )
        child = stack.enter_context(SimChild(job))
        channels, clock = self._twin.channels, SystemClock()
        machine = stack.enter_context(EpicsMachine(channels, _network(child.port), clock))
        self._slot = PolicySlot(self._build(self._twin.response_at(0)))
        history = History(channels, 4000)
        period = 1.0 / settings.rate_hz
        self._runner = Runner(
            machine,
            self._slot,
            LoopSettings(rate_hz=settings.rate_hz, hold_after=max(1.9, _SLACK / period)),
            LimitSettings(),
            InterlockSettings(),
            np.zeros(len(channels.bpms)),
            clock,
            start=LoopState.CLOSED,
            subscribers=(history, self._note),
        )
        self._reports: list[RefitReport] = []
        if law == "ours":
            build = builder(PolicySettings(svd=settings.policy))
            learner = Learner(self._twin.response_at(0), settings.learn, build, seed=settings.seed)
            thread = LearnerThread(
                InlineTrainer(learner), history, self._slot, self._reports.append, poll=_POLL
            )
            thread.start()
            stack.callback(thread.stop)
        elif law == "told":
            teller = threading.Thread(target=self._tell, name="teller")
            teller.start()
            stack.callback(teller.join)
            stack.callback(self._done.set)

    def run(self) -> LiveRun:
        self._runner.run(self._done)
        runner = self._runner
        return LiveRun(
            self._true_rms, self._missed, runner.state, runner.reason, tuple(self._reports)
        )

    def _build(self, response: Vector) -> SvdPolicy:
        return SvdPolicy(response, self._settings.policy)

    def _note(self, record: TickRecord) -> None:
        """Take a record; ends the run when the ring has made all its ticks."""
        self._missed += record.missed
        if record.reading is None:
            return
        tick = record.reading.auxiliary["tick"]
        if not np.isfinite(tick):
            return
        self._tick = int(tick)
        if self._tick < len(self._true_rms):
            self._true_rms[self._tick] = record.reading.auxiliary["true_orbit_rms"]
        else:
            self._done.set()

    def _tell(self) -> None:
        """Keep the policy true to the ring, beside the loop."""
        told = 0
        while not self._done.wait(_POLL):
            if self._tick - told >= _TOLD_EVERY:
                told = self._tick
                self._slot.swap(self._build(self._twin.response_at(told)))


def _network(port: int) -> EpicsSettings:
    settings = EpicsSettings(server_port=port)
    simulated = {
        "true_orbit_rms": AuxiliarySettings(pv=TRUE_RMS_PV, scale=1e-3),
        "tick": AuxiliarySettings(pv=TICK_PV),
    }
    return settings.model_copy(update={"auxiliary": {**settings.auxiliary, **simulated}})
