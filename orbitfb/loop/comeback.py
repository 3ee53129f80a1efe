"""Back to the last good setpoints after a trip for the orbit, in limited steps; off by default.

The way is straight: if the orbit of the good setpoints was good, the error shrinks along it. So
whatever is wrong on the way, a larger error for one, ends it at once.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import LoopState, Mask, Vector
from orbitfb.core.values import replace
from orbitfb.loop.memory import LoopMemory, Rules, Way
from orbitfb.loop.tick import Checked
from orbitfb.safety.bounds import Bounds
from orbitfb.safety.limits import Limited, limit
from orbitfb.safety.verdict import Verdict

CAUSES = frozenset({"orbit_distortion", "distortion_rate", "divergence", "prediction"})
"""Interlocks after which the setpoints may be the reason for the orbit."""

_WORSE, _NOISE = 1.1, 5e-6
"""Growth of the error [1], and [m] besides, that ends the way."""


@dataclass(frozen=True, slots=True)
class Step:
    """What to do next.

    Args:
        memory: With the way, or its end.
        limited: What to send; None: nothing.
    """

    memory: LoopMemory
    limited: Limited | None = None


def remember_good(memory: LoopMemory, checked: Checked, rules: Rules) -> LoopMemory:
    """Keep the setpoints of an orbit that was good.

    Args:
        memory: Of the tick; its setpoints were in force at the orbit.
        checked: That orbit.
        rules: Say what good is.
    """
    wanted = rules.loop.return_after_trip and memory.state is LoopState.CLOSED
    if wanted and checked.verdict.may_act and checked.rms <= rules.loop.return_good:
        return replace(memory, well=memory.setpoints)
    return memory


def set_out(memory: LoopMemory, before: LoopState, verdict: Verdict, rules: Rules) -> LoopMemory:
    """Begin the way back if a CLOSED loop has just tripped for its orbit.

    Args:
        memory: After the trip.
        before: State before it.
        verdict: What tripped it.
        rules: Say whether to.
    """
    tripped = before is LoopState.CLOSED and memory.state is LoopState.TRIPPED
    if not tripped or not rules.loop.return_after_trip or verdict.cause not in CAUSES:
        return memory
    if memory.well is None:
        return replace(memory, reason=f"{memory.reason}; no good setpoints are known: they stay")
    return replace(memory, way=Way(memory.reason, memory.well))


def stop(memory: LoopMemory, why: str) -> LoopMemory:
    """End the way, if there is one.

    Args:
        memory: So far.
        why: What is wrong.
    """
    way = memory.way
    if way is None:
        return memory
    reason = f"{way.cause}; return stopped after {way.steps} steps: {why}"
    return replace(memory, way=None, reason=reason)


def next_step(
    memory: LoopMemory,
    checked: Checked,
    rules: Rules,
    mine: Mask,
    ask: Callable[[], tuple[LoopMemory, str]],
    bounds: Bounds | None = None,
) -> Step:
    """Say what the next step is.

    Args:
        memory: Of a loop that is TRIPPED.
        checked: The orbit of this tick.
        rules: Limits of the steps.
        mine: Correctors that the loop moves, shape (m,).
        ask: Asks for the setpoints in force; gives what is wrong with them.
        bounds: Where the setpoint of each may be; None: the same for all, by the rules.
    """
    way = memory.way
    if way is None:
        return Step(memory)
    if not checked.sound.may_act:
        return Step(stop(memory, checked.sound.reason))
    if not checked.rms <= _WORSE * way.rms + _NOISE:
        grown = f"from {way.rms * 1e6:.3g} to {checked.rms * 1e6:.3g} µm rms"
        return Step(stop(memory, f"the orbit error grew {grown}"))
    memory, trouble = ask()
    if trouble:
        return Step(stop(memory, trouble))
    way = replace(way, rms=min(way.rms, checked.rms), seen=way.seen + 1)
    if way.seen <= rules.loop.proving:  # what was sent before the trip arrives first
        return Step(replace(memory, way=way))
    left = np.where(mine, way.good - memory.setpoints, 0.0)
    limited = limit(_cut(left, rules), memory.setpoints, rules.limits, bounds=bounds)
    if limited.scale < 1.0:
        return Step(stop(memory, limited.verdict.reason))
    if not limited.change.any():
        reason = f"{way.cause}; returned to the last good setpoints in {way.steps} steps"
        return Step(replace(memory, way=None, reason=reason))
    way = replace(way, steps=way.steps + 1)
    reason = f"{way.cause}; returning to the last good setpoints"
    return Step(replace(memory, way=way, reason=reason), limited)


def _cut(left: Vector, rules: Rules) -> Vector:
    """Shorten what is left of the way to one step."""
    largest = float(np.abs(left).max(initial=0.0))
    step = min(rules.loop.return_step, rules.limits.change_per_tick)
    return left if largest <= step else left * (step / largest)
