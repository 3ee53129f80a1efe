"""What the learner promotes on a ring that rests and on rings that drift.

    python -m benchmarks.promotions [--minutes 60] [--drift none,paper,mild,strong] [--seed 1]
                                    [--rule before,now] [--policy svd] [--caution 0.1]
                                    [--period 30] [--regularisation 3e-8] [--price 6e-8]
                                    [--drift-ticks 18000]

The loop runs in process, as fast as it goes, with the service's own learner: identification,
judge, shadow and watch, at 10 orbits a second. Every run is made twice on the same ring and the
same noise: by the rule `before` (a predicted gain of 0.2 %, whatever its interval) and by the rule
of the configuration. Both are told side by side: refits, how many of them were promoted with
the 95 % interval of that share (Wilson), when the first useful one came, the true orbit, that over
the one of a loop that is told the true response every two seconds, the share of the errors of R̂
within two of their standard deviations, every fifty seconds, and the largest setpoint. R̂ is the
learner's, of the adaptive law its own, and beside that law it is the noise-aware one (`modal`)
that is told the response.

A promotion is useful when the loop on the true response is better with it than with the policy of
the start by more than a swap costs (`orbitfb.learn.watch.swap_cost`).
"""

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[_name] = "1"  # before numpy is imported

import argparse  # noqa: E402
from collections.abc import Mapping  # noqa: E402
from dataclasses import dataclass, replace  # noqa: E402
from typing import Any  # noqa: E402

import numpy as np  # noqa: E402

from orbitfb.core.clock import ManualClock  # noqa: E402
from orbitfb.core.ports import Policy  # noqa: E402
from orbitfb.core.refit import Decision, RefitReport  # noqa: E402
from orbitfb.core.transitions import Transitions  # noqa: E402
from orbitfb.estimation.recursive.estimate import RecursiveResponse  # noqa: E402
from orbitfb.evaluate.live_settings import informed  # noqa: E402
from orbitfb.evaluate.simulate import ClosedLoop  # noqa: E402
from orbitfb.learn.builders import builder, first_policy  # noqa: E402
from orbitfb.learn.forecast import predict_loop  # noqa: E402
from orbitfb.learn.judge import gain_of  # noqa: E402
from orbitfb.learn.learner import Learner  # noqa: E402
from orbitfb.learn.settings import LearnSettings  # noqa: E402
from orbitfb.learn.trainer import InlineTrainer  # noqa: E402
from orbitfb.learn.watch import swap_cost  # noqa: E402
from orbitfb.learn.worker import LearnerThread  # noqa: E402
from orbitfb.loop.slot import PolicySlot  # noqa: E402
from orbitfb.models.linear import LinearModel  # noqa: E402
from orbitfb.physics.drift import DriftSettings  # noqa: E402
from orbitfb.physics.places import Ring  # noqa: E402
from orbitfb.physics.plant import Plant, PlantSettings  # noqa: E402
from orbitfb.policies.adaptive import Track  # noqa: E402
from orbitfb.policies.settings import PolicySettings  # noqa: E402

RATE = 10.0
_TOLD, _ASKED = 20, 500
"""Ticks between two true responses that are told, and between two looks at the errors of R̂."""
_POLL = 4
"""Ticks between two looks of the learner; the service looks five times a second."""
RULES: Mapping[str, Mapping[str, Any]] = {
    "before": {"margin": 0.002, "resolved": False},
    "now": {},
}
"""Settings of the judge by the name of the rule."""


@dataclass(frozen=True, slots=True)
class Event:
    """What became of one refit.

    Args:
        tick: When it was told [ticks].
        decision: What.
        gain: True gain of the loop with a promoted policy over that of the start [1]; nan for
            others.
    """

    tick: int
    decision: str
    gain: float


@dataclass(frozen=True, slots=True)
class Run:
    """One hour, say, under one rule.

    Args:
        events: Of the learner.
        true_rms: True orbit of every tick [m].
        largest: Largest setpoint of any corrector [A].
        covered: Share of the errors of R̂ within two standard deviations, one for every look [1].
    """

    events: tuple[Event, ...]
    true_rms: np.ndarray
    largest: float
    covered: tuple[float, ...] = ()

    @property
    def rms(self) -> float:
        """True orbit after the first minute, in which the start is corrected, rms [m]."""
        return float(np.sqrt(np.mean(self.true_rms[int(60 * RATE) :] ** 2)))

    @property
    def refits(self) -> int:
        """Candidates that were judged."""
        return sum(event.decision != Decision.ROLLED_BACK for event in self.events)

    @property
    def promoted(self) -> int:
        """Candidates that were put in force."""
        return sum(event.decision == Decision.PROMOTED for event in self.events)

    def first_useful(self, margin: float) -> int | None:
        """Tick of the first promotion that makes the loop better; None: there was none."""
        useful = (event.tick for event in self.events if event.gain > margin)
        return next(useful, None)


def plant(drift: DriftSettings, seed: int) -> Plant:
    """Make the ring of a run."""
    return Plant(Ring.load(), "x", PlantSettings(drift=drift), seed)


def told(drift: DriftSettings, seed: int, ticks: int, policy: PolicySettings) -> Run:
    """Run the loop that is told the true response."""
    ring = plant(drift, seed)
    loop = ClosedLoop(ring, first_policy(ring.response, policy), ticks)
    loop.run(lambda its: first_policy(its.plant.response, policy), _TOLD)
    return Run((), loop.true_rms, loop.largest)


class Bench:
    """A ring, its loop and the learner's work, stepped by hand.

    Args:
        drift: Of R.
        seed: Of ring, noise and drift.
        ticks: How long.
        judge: Settings of the judge that differ from the defaults.
        policy: Kind of the policy.
    """

    def __init__(
        self,
        drift: DriftSettings,
        seed: int,
        ticks: int,
        judge: Mapping[str, Any],
        policy: PolicySettings,
    ) -> None:
        self._plant = plant(drift, seed)
        first = first_policy(self._plant.response, policy)
        self._slot = PolicySlot(first)
        self._loop = ClosedLoop(self._plant, first, ticks)
        settings = LearnSettings.model_validate({"judge": judge})
        response = self._plant.response
        self._learner = Learner(response, settings, builder(policy), ManualClock(), seed, RATE)
        self._events: list[Event] = []
        self._clock = ManualClock()
        self._thread = LearnerThread(
            InlineTrainer(self._learner), self, self._slot, self._note, clock=self._clock
        )
        self._first: Policy = first

    def snapshot(self, last: int | None = None, since_tick: int | None = None) -> Transitions:
        """Give the transitions that the learner asks for."""
        if last is not None:
            return self._loop.transitions(self._loop.tick - 1 - last)
        return self._loop.transitions(since_tick or 0)

    def run(self) -> Run:
        """Run to the end."""
        covered: list[float] = []
        while self._loop.tick < len(self._loop.true_rms) and not self._loop.lost:
            self._loop.advance(_POLL)
            self._thread.step()
            self._loop.policy = self._slot.current
            if self._loop.tick % _ASKED == 0:
                errors = self._known().normalised_errors(self._plant.response)
                covered.append(float(np.mean(np.abs(errors) < 2.0)))
        true_rms = self._loop.true_rms[: self._loop.tick]
        return Run(tuple(self._events), true_rms, self._loop.largest, tuple(covered))

    def _known(self) -> LinearModel | RecursiveResponse:
        """Give the estimate that the gain is made of."""
        state = self._loop.policy_state
        return state.estimate if isinstance(state, Track) else self._learner.model

    def _note(self, report: RefitReport) -> None:
        gain = float("nan")
        if report.decision is Decision.PROMOTED:
            gain = 1.0 - self._on_truth(self._slot.current) / self._on_truth(self._first)
        self._events.append(Event(self._loop.tick, str(report.decision), gain))

    def _on_truth(self, policy: Policy) -> float:
        """Predict the true orbit on the true response under the noise as estimated, rms [m]."""
        model, truth = self._learner.model, self._plant.response
        model = replace(model, creep=np.zeros_like(model.creep))
        return predict_loop(gain_of(policy, len(truth)), [truth], model, 512).rms


def wilson(count: int, total: int) -> tuple[float, float]:
    """Give the 95 % interval of a share, Wilson's."""
    if total == 0:
        return 0.0, 1.0
    share, square = count / total, 1.96**2
    middle = (share + square / (2 * total)) / (1 + square / total)
    half = 1.96 * np.sqrt(share * (1 - share) / total + square / (4 * total**2))
    half /= 1 + square / total
    return float(middle - half), float(middle + half)


def line(drift: str, seed: int, rule: str, run: Run, bound: Run) -> str:
    """Say what came of one run."""
    low, high = wilson(run.promoted, run.refits)
    first = run.first_useful(swap_cost(LearnSettings()))
    useful = "none" if first is None else f"{first / RATE:.0f} s"
    return (
        f"{drift:<7}{seed:>4}  {rule:<7}{run.refits:>7}{run.promoted:>9}"
        f"   {100 * run.promoted / max(run.refits, 1):4.1f} [{100 * low:.1f}, {100 * high:.1f}] %"
        f"   {useful:>8}   {run.rms * 1e6:.4f}   {run.rms / bound.rms:9.3f}"
        f"   {100 * np.mean(run.covered):.1f} %   {run.largest:.3g} A"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0, help="simulated minutes of a run")
    parser.add_argument("--drift", default="none,paper,mild,strong", help="presets, by commas")
    parser.add_argument("--seed", type=int, default=1, help="of ring, noise and drift")
    parser.add_argument("--rule", default="before,now", help="rules, by commas")
    parser.add_argument("--policy", default="svd", help="kind of the policy")
    parser.add_argument("--caution", type=float, help="of the law `adaptive`, if not its default")
    parser.add_argument("--period", type=int, help="of its gain [ticks], if not its default")
    parser.add_argument("--regularisation", type=float, help="of its gain [m/A], the same way")
    parser.add_argument("--price", type=float, help="of what it holds [m/A²], the same way")
    parser.add_argument("--drift-ticks", type=int, help="over which R drifts, if not the default")
    options = parser.parse_args()
    ticks = int(options.minutes * 60 * RATE)
    policy = PolicySettings(kind=options.policy)
    names = ("caution", "period", "regularisation", "price")
    chosen = {name: getattr(options, name) for name in names}
    chosen = {name: value for name, value in chosen.items() if value is not None}
    if chosen:
        caution = policy.adaptive.caution.model_copy(update=chosen)
        law = policy.adaptive.model_copy(update={"caution": caution})
        policy = policy.model_copy(update={"adaptive": law})
    print(
        "drift  seed  rule    refits promoted   share               first useful   true um rms"
        "   over told   covered   largest"
    )
    over = {} if options.drift_ticks is None else {"ticks": options.drift_ticks}
    for name in options.drift.split(","):
        drift = DriftSettings.model_validate({"preset": name, **over})
        bound = told(drift, options.seed, ticks, informed(policy))
        for rule in options.rule.split(","):
            run = Bench(drift, options.seed, ticks, RULES[rule], policy).run()
            print(line(name, options.seed, rule, run, bound), flush=True)


if __name__ == "__main__":
    main()
