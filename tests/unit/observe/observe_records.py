"""Records made by hand, for every test of what is shown."""

import math

import numpy as np

from orbitfb.core.clock import ManualClock
from orbitfb.core.refit import Decision, RefitReport
from orbitfb.core.signals import (
    Channels,
    LoopState,
    Orbit,
    Phases,
    Reading,
    TickRecord,
)


def channels(planes: str = "x", bpms: int = 4, correctors: int = 3) -> Channels:
    names = tuple(f"BPM{i}" for i in range(bpms))
    kicks = tuple(f"COR{i}" for i in range(correctors))
    counts = (correctors - correctors // 2, correctors // 2) if planes == "xy" else ()
    return Channels(planes, names, kicks, names, kicks, kicks, corrector_counts=counts)


def record(
    tick: int = 1,
    error: object = (1e-6, -1e-6, 1e-6, -1e-6),
    *,
    time: float = 1000.0,
    received: float = 0.0,
    state: LoopState = LoopState.CLOSED,
    reason: str = "",
    valid: object = None,
    setpoints: object = (1.0, -2.0, 0.5),
    applied: object = (0.0, 0.0, 0.0),
    true: float = math.nan,
    auxiliary: dict[str, float] | None = None,
    scale: float = 1.0,
    policy_id: str = "svd-1",
    latency: float = math.nan,
    missed: int = 0,
    lost: bool = False,
    held_back: bool = False,
) -> TickRecord:
    """Return a record whose orbit is reference + error; `lost` leaves the reading out."""
    distance = np.asarray(error, dtype=np.float64)
    reference = np.linspace(1e-3, 2e-3, distance.size)
    good = np.ones(distance.size, bool) if valid is None else np.asarray(valid, bool)
    slow = dict(auxiliary or {})
    if not math.isnan(true):
        slow["true_orbit_rms"] = true
    position = np.where(good, reference + distance, np.nan)
    change = np.asarray(applied, dtype=np.float64)
    reading = Reading(Orbit(position, good, time), np.zeros(change.size), slow, received)
    return TickRecord(
        tick=tick,
        state=state,
        reason=reason,
        reading=None if lost else reading,
        reference=reference,
        setpoints=np.asarray(setpoints, dtype=np.float64),
        requested=change,
        dither=np.zeros(change.size),
        applied=change,
        scale=scale,
        written=math.nan,
        policy_id=policy_id,
        phases=Phases(0.09, 1e-4, 2e-4, 3e-5, 1e-3),
        latency=latency,
        missed=missed,
        held_back=held_back,
    )


def report(decision: Decision = Decision.REFUSED, number: int = 1, **figures: float) -> RefitReport:
    return RefitReport(
        number=number,
        time=1.7e9,
        trigger="periodic",
        rows=600,
        decision=decision,
        reason="gains 0.3 %, less than 2 %",
        policy_id=f"refit-{number:04d}",
        incumbent_id="svd-1",
        figures=figures,
        duration=0.2,
    )


def feed(statistics, clock: ManualClock, ticks: int, *, period: float = 0.1, **fields) -> None:
    """Feed ticks one period apart; a field that is callable is asked for each tick."""
    for tick in range(1, ticks + 1):
        clock.advance(period)
        values = {name: f(tick) if callable(f) else f for name, f in fields.items()}
        statistics(record(tick, time=clock.wall(), received=clock.monotonic(), **values))
