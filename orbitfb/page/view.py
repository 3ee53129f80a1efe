"""What the page shows of one moment, as values that JSON knows, in the units of the PVs."""

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from orbitfb import __version__
from orbitfb.core.ports import Clock
from orbitfb.core.refit import RefitReport
from orbitfb.core.signals import LoopState, Mask, TickRecord, Vector
from orbitfb.loop.frequency import Sight
from orbitfb.measure.progress import Progress
from orbitfb.observe.plain import plain
from orbitfb.observe.statistics.snapshot import Happening, LoopSnapshot

MICRO, MILLI = 1e-6, 1e-3
GOOD, INVALID, LEFT_OUT = "0", "1", "2"
"""What a BPM is: it counts; its reading is not valid; somebody left it out."""
SHOWN_HAPPENINGS = 12
_COMMANDS = {"open": "opened", "shadow": "put in shadow", "close": "closed", "reset": "reset"}


@dataclass(frozen=True, slots=True)
class Sources:
    """Where the page's values come from; each is called from any thread.

    Args:
        snapshot: Gives the figures of the loop.
        record: Gives the last record with an orbit; None: there was none yet.
        enabled: Gives the BPMs that count as far as operators and configuration say, shape (n,).
        movable: Gives the correctors that may move, shape (m,).
        gap: Says the gap between model and machine in a sentence.
        peaks: Gives the largest orbit RMS of late by plane [m], the monotonic time [s] in.
        noise: Noise of one BPM reading to believe before a refit has found it, rms [m].
        rf: Gives how the RF frequency is.
        measurement: Gives how far a measurement of the response is.
        hand_over: Gives how our reference is handed to a fast feedback, `state`, `reason` and
            `left_um`; None: there is none that takes it.
    """

    snapshot: Callable[[], LoopSnapshot]
    record: Callable[[], TickRecord | None]
    enabled: Callable[[], Mask]
    movable: Callable[[], Mask]
    gap: Callable[[LoopSnapshot], str]
    peaks: Callable[[float], Mapping[str, float]]
    noise: float = math.nan
    rf: Callable[[], Sight] = Sight
    measurement: Callable[[], Progress] = Progress
    hand_over: Callable[[], Mapping[str, Any] | None] = lambda: None


class PageView:
    """Answers what the page asks; remembers who commanded the loop last.

    Args:
        sources: Of the values.
        clock: Of the loop.
        stale_after: Time without a tick after which the loop counts as not alive [s].
    """

    def __init__(self, sources: Sources, clock: Clock, stale_after: float) -> None:
        self._sources, self._clock, self._stale_after = sources, clock, stale_after
        self._started = clock.wall()
        self._lock = threading.Lock()
        self._seen = 0
        self._command: dict[str, Any] | None = None
        self._policy_since = self._started

    def __call__(self, _request: object = None) -> dict[str, Any]:
        """Give everything that the page shows of this moment."""
        snapshot = self._sources.snapshot()
        with self._lock:
            self._remember(snapshot)
            command, policy_since = self._command, self._policy_since
        source, floor = snapshot.noise_floor(self._sources.noise)
        ticking = snapshot.state is not None and snapshot.state is not LoopState.FAULT
        return {
            **plain(
                {
                    "version": __version__,
                    "started": self._started,
                    "time": self._clock.wall(),
                    "alive": ticking and snapshot.ticks.age < self._stale_after,
                    "state": snapshot.state,
                    "reason": snapshot.reason,
                    "in_state": snapshot.in_state,
                    "command": command,
                    "policy": snapshot.policy_id,
                    "policy_since": policy_since,
                    "floor_um": floor / MICRO,
                    "floor_source": source,
                    **_figures(snapshot),
                    "rms_peak_um": self._peaks(snapshot),
                    "rf": _rf(self._sources.rf(), snapshot.last_refit),
                    "measurement": _measurement(self._sources.measurement()),
                    "hand_over": self._sources.hand_over(),
                    "gap": _gap(snapshot, self._sources.gap(snapshot)),
                    "happenings": [
                        {"time": its.time, "kind": its.kind, "text": its.text}
                        for its in snapshot.happenings[-SHOWN_HAPPENINGS:]
                    ],
                }
            ),
            **self._vectors(),
        }

    def _peaks(self, snapshot: LoopSnapshot) -> dict[str, float]:
        largest = self._sources.peaks(self._clock.monotonic())
        return {  # that of the last orbit where a slow loop had none of late
            plane: float(np.fmax(largest[plane], rms.now)) / MICRO
            for plane, rms in snapshot.orbit.planes.items()
        }

    def _remember(self, snapshot: LoopSnapshot) -> None:
        for happening in snapshot.happenings:
            if happening.number > self._seen:
                self._seen = happening.number
                self._command = _command(happening) or self._command
                if happening.kind == "policy" and " instead of " in happening.text:
                    self._policy_since = happening.time

    def _vectors(self) -> dict[str, Any]:
        record = self._sources.record()
        if record is None or record.reading is None:
            return {"orbit_um": [], "error_um": [], "bpms": "", "setpoints_A": [], "stamp": None}
        orbit = record.reading.orbit
        valid = orbit.valid & np.isfinite(orbit.position)
        flags = np.where(self._sources.enabled(), np.where(valid, GOOD, INVALID), LEFT_OUT)
        return {
            "orbit_um": _rounded(np.where(valid, orbit.position, np.nan) / MICRO, 3),
            "error_um": _rounded(
                np.where(valid, orbit.position - record.reference, np.nan) / MICRO, 3
            ),
            "bpms": "".join(flags.tolist()),
            "setpoints_A": _rounded(record.setpoints + record.applied, 5),
            "movable": "".join(np.where(self._sources.movable(), "1", "0").tolist()),
            "stamp": orbit.time,
            "orbit_tick": record.tick,
            "orbit_age": max(0.0, self._clock.monotonic() - record.reading.received),
        }


def _figures(snapshot: LoopSnapshot) -> dict[str, Any]:
    orbit, nearest, ticks = snapshot.orbit, snapshot.correctors, snapshot.ticks
    last = snapshot.last_refit
    return {
        "rms_um": {plane: rms.now / MICRO for plane, rms in orbit.planes.items()},
        "rms_10s_um": {plane: rms.window / MICRO for plane, rms in orbit.planes.items()},
        "worst_um": orbit.worst / MICRO,
        "worst_bpm": orbit.worst_bpm,
        "bpms_invalid": orbit.invalid,
        "bpms_masked": orbit.masked,
        "nearest": {
            "name": nearest.name,
            "setpoint_A": nearest.setpoint,
            "limit_A": nearest.limit,
        },
        "limited": nearest.limited,
        "ticks": ticks.ticks,
        "missed": ticks.missed,
        "tick_age": ticks.age,
        "period_ms": ticks.period / MILLI,
        "jitter_ms": ticks.jitter / MILLI,
        "latency50_ms": snapshot.latency.p50 / MILLI,
        "latency99_ms": snapshot.latency.p99 / MILLI,
        "current_mA": snapshot.auxiliary.get("current", math.nan) / MILLI,
        "swaps": snapshot.swaps,
        "refits": {decision.value: count for decision, count in snapshot.refits.items()},
        "last_refit": last
        and {
            "time": last.time,
            "trigger": last.trigger,
            "decision": last.decision.value,
            "reason": last.reason,
            "policy": last.policy_id,
        },
        "alarms": {cause.value: count for cause, count in snapshot.alarms.items()},
    }


def _rf(sight: Sight, last: RefitReport | None) -> dict[str, Any]:
    figures = {} if last is None else last.figures
    found = [figures.get(name) for name in ("rf_ratio", "rf_ratio_low", "rf_ratio_high")]
    return {
        "follows": sight.following,
        "reason": sight.reason,
        "frequency_Hz": sight.frequency,
        "energy_ppm": sight.energy / MICRO,
        "steps": sight.steps,
        "column": sight.ratio,
        "found": found if figures.get("rf_steps") else None,
    }


def _measurement(progress: Progress) -> dict[str, Any]:
    return {
        "state": progress.stage,
        "running": progress.running,
        "done": progress.done,
        "total": progress.total,
        "share": progress.share,
        "left_s": progress.left,
        "text": progress.text,
    }


def _gap(snapshot: LoopSnapshot, headline: str) -> dict[str, Any]:
    gap = snapshot.gap
    if gap is None:
        return {"headline": headline, "resolved": False, "time": None}
    return {
        "headline": headline,
        "resolved": gap.resolved,
        "time": gap.time,
        "nats": gap.nats,
        "effect": gap.effect,
    }


def _command(happening: Happening) -> dict[str, Any] | None:
    """Tell who moved the loop from state to state; None: this is about something else."""
    if happening.kind != "command":
        return None
    name, by, rest = happening.text.partition(" by ")
    who, refused, _ = rest.partition(" refused: ")
    if name not in _COMMANDS or not by or refused:
        return None
    return {"did": _COMMANDS[name], "by": who, "time": happening.time}


def _rounded(vector: Vector, digits: int) -> list[float | None]:
    rounded = np.round(vector, digits).tolist()
    return [value if math.isfinite(value) else None for value in rounded]
