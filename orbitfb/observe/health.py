"""Is the loop alive, is it ready: answers for probes, as functions of a snapshot."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from orbitfb.core.signals import LoopState
from orbitfb.observe.plain import plain
from orbitfb.observe.statistics.snapshot import LoopSnapshot

READY = (LoopState.OPEN, LoopState.SHADOW, LoopState.CLOSED)


@dataclass(frozen=True, slots=True)
class Verdict:
    """Answer to a probe.

    Args:
        good: Whether the answer is yes.
        body: Why, for the reader; made of what JSON knows.
    """

    good: bool
    body: dict[str, Any]


def health(snapshot: LoopSnapshot, stale_after: float, troubles: Sequence[str] = ()) -> Verdict:
    """Say whether the process is alive: restart it if not.

    Args:
        snapshot: Figures of this moment.
        stale_after: Time without a tick after which the loop is not alive [s].
        troubles: What does not work now though the loop does. They are told and are no reason
            to restart it.
    """
    verdict = _alive(snapshot, stale_after)
    return replace(verdict, body={**verdict.body, "troubles": list(troubles)})


def _alive(snapshot: LoopSnapshot, stale_after: float) -> Verdict:
    if snapshot.state is LoopState.FAULT:
        return _verdict(False, f"FAULT: {snapshot.reason or 'see the log'}", snapshot)
    if snapshot.ticks.age > stale_after:
        return _verdict(False, _silence(snapshot), snapshot)
    return _verdict(True, "", snapshot)


def readiness(snapshot: LoopSnapshot, stale_after: float) -> Verdict:
    """Say whether the loop does its work: ticks flow and it is OPEN, SHADOW or CLOSED.

    Args:
        snapshot: Figures of this moment.
        stale_after: Time without a tick after which the ticks do not flow [s].
    """
    if snapshot.state is None:
        return _verdict(False, "no tick yet", snapshot)
    if snapshot.state not in READY:
        reason = f": {snapshot.reason}" if snapshot.reason else ""
        return _verdict(False, f"{snapshot.state.value}{reason}", snapshot)
    if snapshot.ticks.age > stale_after:
        return _verdict(False, _silence(snapshot), snapshot)
    return _verdict(True, "", snapshot)


def _silence(snapshot: LoopSnapshot) -> str:
    since = "the start" if snapshot.state is None else "the last one"
    return f"no tick for {snapshot.ticks.age:.1f} s since {since}"


def _verdict(good: bool, reason: str, snapshot: LoopSnapshot) -> Verdict:
    return Verdict(
        good,
        plain(
            {
                "good": good,
                "reason": reason,
                "state": snapshot.state,
                "last_tick_age_s": snapshot.ticks.age,
                "ticks": snapshot.ticks.ticks,
            }
        ),
    )
