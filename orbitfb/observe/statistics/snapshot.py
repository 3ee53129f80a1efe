"""The figures of a running loop at one moment, as values."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from orbitfb.core.gap import GapSight
from orbitfb.core.refit import Alarm, AlarmCause, Decision, RefitReport
from orbitfb.core.signals import LoopState, Phases
from orbitfb.observe.statistics.averages import Ranked


@dataclass(frozen=True, slots=True)
class Rms:
    """An orbit RMS: of the last orbit and over the window.

    Args:
        now: Of the last orbit [m]; NaN when the last tick had none.
        window: Quadratic mean over the window [m]; NaN when unknown.
    """

    now: float
    window: float


@dataclass(frozen=True, slots=True)
class OrbitFigures:
    """Orbit error (orbit − reference) over the valid BPMs, all in m, NaN when unknown.

    Args:
        first: RMS of the first orbit of the run [m].
        observed: RMS as the BPMs read it.
        true: RMS without BPM noise, where the machine (a simulator) tells it.
        planes: RMS by plane, keys `x` and/or `y`.
        worst: Largest |error| of the last orbit [m].
        worst_bpm: Where it is; empty when unknown.
        masked: BPMs that are masked by configuration.
        invalid: BPMs of the last orbit that are invalid besides.
        bpms: All BPMs.
        time: Stamp of the last orbit [s since the epoch].
        worst_bpms: The BPMs with the largest rms error of late, largest first [m].
    """

    first: float
    observed: Rms
    true: Rms
    planes: Mapping[str, Rms]
    worst: float
    worst_bpm: str
    masked: int
    invalid: int
    bpms: int
    time: float
    worst_bpms: tuple[Ranked, ...] = ()


@dataclass(frozen=True, slots=True)
class CorrectorFigures:
    """The corrector that is nearest its limit, and how often the limits shortened a change.

    Args:
        name: Its name; empty before the first tick.
        setpoint: Its absolute setpoint [A]; NaN when unknown.
        limit: Its limit [A].
        limited: Ticks whose change was shortened.
        nearest: The correctors nearest their limits, |setpoint| as part of it, nearest first [1].
        change: Rms change of a setpoint that was written of late [A]; NaN when unknown.
        dither: The dither's part of it [A].
    """

    name: str
    setpoint: float
    limit: float
    limited: int
    nearest: tuple[Ranked, ...] = ()
    change: float = math.nan
    dither: float = math.nan


@dataclass(frozen=True, slots=True)
class TickFigures:
    """Pace of the loop.

    Args:
        ticks: Ticks since the start.
        missed: Orbits that should have come and did not.
        held_back: Ticks that wrote nothing as the last change did not show yet.
        age: Time since the last tick, or since the start if there was none [s].
        time: When the last tick ended, wall clock [s since the epoch]; NaN before the first.
        period: Mean time from orbit to orbit over the window [s]; NaN when unknown.
        jitter: Standard deviation of that time over the window [s]; NaN when unknown.
        phases: Sum of each phase over all ticks [s].
    """

    ticks: int
    missed: int
    held_back: int
    age: float
    time: float
    period: float
    jitter: float
    phases: Phases


@dataclass(frozen=True, slots=True)
class LatencyFigures:
    """From the complete orbit to the last setpoint sent.

    Args:
        p50: Median over the latency window [s]; NaN when nothing was written in it.
        p99: 99th percentile over the latency window [s].
        largest: Largest since the start [s]; NaN when nothing was written.
        buckets: Ticks at or below each of `LATENCY_BOUNDS`, cumulative, then all of them.
        total: Sum since the start [s].
    """

    p50: float
    p99: float
    largest: float
    buckets: tuple[int, ...]
    total: float


@dataclass(frozen=True, slots=True)
class Happening:
    """Something that people want to know when it happens.

    Args:
        number: Count since the start, from 1.
        time: Wall clock [s since the epoch].
        kind: `state`, `policy`, `refit`, `alarm`, `archive`, `gap`, `postmortem`, `command`,
            `lease`, `rf` or `ring`.
        text: What happened, in a few words.
    """

    number: int
    time: float
    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class Closing:
    """Who closed the loop.

    Args:
        user: Their name; `start` when the service began so.
        host: From where.
        time: Wall clock [s since the epoch].
    """

    user: str
    host: str
    time: float


@dataclass(frozen=True, slots=True)
class LoopSnapshot:
    """All figures of a running loop at one moment.

    Args:
        state: State of the loop; None before the first tick.
        reason: Why it is in that state; empty when there is nothing to say.
        in_state: How long it has been in that state [s].
        entries: How often each state was entered.
        duration: Time since the start [s].
        orbit: Orbit error.
        correctors: Distance to the limits.
        ticks: Pace.
        latency: Orbit to setpoint.
        auxiliary: Slow channels of the last orbit by name, SI.
        policy_id: The policy that decides; empty before the first tick.
        swaps: How often the policy changed.
        refits: Reports by decision.
        last_refit: The last report, if there was one.
        alarms: Alarms of the learner by cause.
        last_alarm: The last one, if there was one.
        happenings: The last few, oldest first.
        gap: The last look at the gap between model and machine, if there was one.
        entry_reason: Why the loop entered its state; empty when there is nothing to say.
        closing: Who closed the loop last, if somebody did.
        commands: Commands of operators that were `given` and `refused`.
        noise: Noise of one BPM reading that a refit found last, rms [m]; NaN before that.
        refit_reasons: Refits by decision, stage and reason, figures taken out.
    """

    state: LoopState | None
    reason: str
    in_state: float
    entries: Mapping[LoopState, int]
    duration: float
    orbit: OrbitFigures
    correctors: CorrectorFigures
    ticks: TickFigures
    latency: LatencyFigures
    auxiliary: Mapping[str, float]
    policy_id: str
    swaps: int
    refits: Mapping[Decision, int]
    last_refit: RefitReport | None
    alarms: Mapping[AlarmCause, int]
    last_alarm: Alarm | None
    happenings: tuple[Happening, ...] = field(default=())
    gap: GapSight | None = None
    entry_reason: str = ""
    closing: Closing | None = None
    commands: Mapping[str, int] = field(default_factory=dict)
    noise: float = math.nan
    refit_reasons: Mapping[tuple[str, str, str], int] = field(default_factory=dict)

    @property
    def judged(self) -> int:
        """Refits that came to a verdict: a roll-back is none."""
        return sum(self.refits.values()) - self.refits[Decision.ROLLED_BACK]

    def noise_floor(self, believed: float) -> tuple[str, float]:
        """Give the noise floor of the orbit RMS, and where it comes from.

        Args:
            believed: Noise of one BPM reading as configured, rms [m].

        Returns:
            `refit` and what one found, or `configuration` and what to believe before the first.
        """
        found = not math.isnan(self.noise)
        return ("refit", self.noise) if found else ("configuration", believed)
