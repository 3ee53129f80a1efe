"""What the panel shows of a running loop: values by PV, in the units of the PVs."""

import math
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from orbitfb import __version__
from orbitfb.core.signals import LoopState
from orbitfb.observe.statistics.snapshot import Happening, LoopSnapshot
from orbitfb.panel.pv_table import UNKNOWN_STATE
from orbitfb.panel.pvs.forms import MICRO, MILLI

_PHASES = ("read", "check", "decide", "limit", "act")
_HIGHEST = 2**31 - 1
_FOUND = (
    ("RfFound-I", "rf_ratio"),
    ("RfFoundLow-I", "rf_ratio_low"),
    ("RfFoundHigh-I", "rf_ratio_high"),
)
"""What the last refit found of the RF column: PV and figure."""


class Figures:
    """Turns snapshots into values of PVs; remembers the last one, for means in between.

    Args:
        stale_after: Time without a tick after which the loop counts as not alive [s].
    """

    def __init__(self, stale_after: float) -> None:
        self._stale_after = stale_after
        self._ticks = 0
        self._sums = (0.0,) * len(_PHASES)
        self._phases: tuple[float | None, ...] = (None,) * len(_PHASES)
        self._seen = 0
        self._trip = ""

    def alive(self, snapshot: LoopSnapshot) -> bool:
        """Say whether the loop ticks."""
        ticking = snapshot.state is not None and snapshot.state is not LoopState.FAULT
        return ticking and snapshot.ticks.age < self._stale_after

    def values(self, snapshot: LoopSnapshot, more: Mapping[str, Any]) -> dict[str, Any]:
        """Give the value of every PV; None: not known.

        Args:
            snapshot: Of the loop.
            more: What is not in it, by PV.
        """
        ticks, latency, gap = snapshot.ticks, snapshot.latency, snapshot.gap
        last = snapshot.last_refit
        values: dict[str, Any] = {
            "State-I": snapshot.state.value if snapshot.state else UNKNOWN_STATE,
            "Reason-I": snapshot.reason,
            "LastTrip-I": self._last_trip(snapshot.happenings),
            "Version-I": __version__,
            "LogLine-I": _line(snapshot.happenings[-1]) if snapshot.happenings else "",
            "BpmsInvalid-I": snapshot.orbit.invalid,
            "Ticks-I": min(ticks.ticks, _HIGHEST),
            "Missed-I": min(ticks.missed, _HIGHEST),
            "Period-I": _number(ticks.period, MILLI),
            "Jitter-I": _number(ticks.jitter, MILLI),
            "Latency50-I": _number(latency.p50, MILLI),
            "Latency99-I": _number(latency.p99, MILLI),
            "LatencyMax-I": _number(latency.largest, MILLI),
            "Gap-I": None if gap is None else _number(gap.nats, 1.0),
            "GapText-I": gap_text(snapshot),
            "Policy-I": snapshot.policy_id,
            "LastRefit-I": f"{last.policy_id} {last.decision}: {last.reason}" if last else "",
            **{
                pv: _number(last.figures.get(name, math.nan), 1.0) if last else None
                for pv, name in _FOUND
            },
            **self._mean_phases(snapshot),
        }
        for plane, rms in snapshot.orbit.planes.items():
            values[f"Rms{plane.upper()}-I"] = _number(rms.now, MICRO)
        return values | dict(more)

    def _mean_phases(self, snapshot: LoopSnapshot) -> dict[str, float | None]:
        phases, ticks = snapshot.ticks.phases, snapshot.ticks.ticks
        sums = (phases.read, phases.check, phases.decide, phases.limit, phases.act)
        if ticks > self._ticks:
            between = ticks - self._ticks
            self._phases = tuple(
                (now - before) / between / MILLI
                for now, before in zip(sums, self._sums, strict=True)
            )
            self._ticks, self._sums = ticks, sums
        return {
            f"Tick{name.capitalize()}-I": mean
            for name, mean in zip(_PHASES, self._phases, strict=True)
        }

    def _last_trip(self, happenings: tuple[Happening, ...]) -> str:
        trip = LoopState.TRIPPED.value
        for happening in happenings:
            if happening.number > self._seen:
                self._seen = happening.number
                if happening.kind == "state" and happening.text.startswith(trip):
                    reason = happening.text.removeprefix(trip).removeprefix(": ")
                    self._trip = f"{_clock(happening.time)} {reason}"
        return self._trip


def _number(value: float, unit: float) -> float | None:
    return value / unit if math.isfinite(value) else None


def _clock(time: float) -> str:
    return datetime.fromtimestamp(time, UTC).isoformat(sep=" ", timespec="seconds")


def _line(happening: Happening) -> str:
    return f"{_clock(happening.time)} {happening.kind}: {happening.text}"


def gap_text(snapshot: LoopSnapshot) -> str:
    """Say the gap between model and machine in a sentence."""
    gap = snapshot.gap
    if gap is None:
        return "no comparison with the model yet"
    if not gap.resolved:
        return f"none that is certain in {gap.ticks} ticks"
    where = f" at {', '.join(gap.places[:3])}" if gap.places else ""
    return (
        f"{gap.nats:.3g} nats/tick ({gap.low:.3g} to {gap.high:.3g}); {gap.effect or 'nothing'} "
        f"suspected{where}, probability {gap.probability:.2g}"
    )
