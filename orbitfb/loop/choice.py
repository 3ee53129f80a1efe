"""What to send: the guarded policy's change, dithered, limited, without correctors at a limit."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.loop.guard import Decision, Guard
from orbitfb.loop.memory import LoopMemory, Rules
from orbitfb.loop.tick import Checked
from orbitfb.safety.limits import Limited, at_limit, limit, near_limit

ROUNDS = 12
"""How often correctors at a limit leave the solution."""
_SHARE = 0.3
"""Part of a period after which the solution is not tried again."""


@dataclass(frozen=True, slots=True)
class Choice:
    """A change that is ready to be sent.

    Args:
        limited: What may be sent.
        requested: What was asked for, shape (m,) [A].
        dither: The dither's part of it, shape (m,) [A].
        policy_state: What the policy would carry on.
        settled: Whether that may be kept: the change is what the policy asked for.
        reasons: What there is to say; empty when nothing.
    """

    limited: Limited
    requested: Vector
    dither: Vector
    policy_state: Any
    settled: bool
    reasons: tuple[str, ...]

    @property
    def whole(self) -> bool:
        """Whether all that was asked for may be sent."""
        return self.limited.verdict.may_act and self.limited.scale == 1.0 and self.settled


def choose(
    guard: Guard,
    checked: Checked,
    memory: LoopMemory,
    rules: Rules,
    gain: Vector,
    dither: Vector,
    mine: Mask,
    resting: Mask,
    done: Callable[[str], float],
    besides: Vector | None = None,
) -> Choice:
    """Decide and limit; correctors that would go beyond their limit leave the solution.

    Args:
        guard: Asks the policy, or the baseline.
        checked: The orbit error and what of it counts.
        memory: Of the loop.
        rules: Limits and names.
        gain: Factor of the policy's change, shape (m,) [1].
        dither: Shape (m,) [A].
        mine: Correctors that the loop moves, shape (m,).
        resting: Those whose setpoints the policy leaves as they are for now, shape (m,).
        done: Told the phase of the tick that has just ended.
        besides: Change that goes with a step of the RF frequency, shape (m,) [A]; None: none does.
    """
    names = rules.channels.correctors
    bounds = guard.bounds(rules.limits.setpoint, len(mine))
    out, state, alarm = memory.lost, memory.policy_state, ""
    full: Mask = np.zeros_like(out)
    rounds, began = 0, done("limit")
    while True:
        asked = guard.policy
        decision: Decision = guard.decide(checked, state, out | resting)
        alarm = alarm or decision.alarm or guard.alarm
        if guard.policy is not asked:
            state = guard.policy.initial_state()
        change, shaken = decision.change, dither
        moves = mine & ~out
        if not moves.all():  # also of a policy that cannot be solved for the others
            change, shaken = np.where(moves, change, 0.0), np.where(moves, dither, 0.0)
        if resting.any():
            change = np.where(resting, 0.0, change)
        requested = gain * change + shaken
        if besides is not None:
            requested = requested + besides
        done("decide")
        limited = limit(requested, memory.setpoints, rules.limits, names, bounds)
        spent = done("limit") - began > _SHARE * rules.loop.period
        tight = limited.at_limit
        more = out | tight
        rounds += 1
        alone = not guard.can_leave_out or not (mine & ~more).any()
        if rounds > ROUNDS or spent or not tight.any() or alone:
            break
        out, full = more, full | tight
    reasons = [alarm, limited.verdict.reason]
    if not full.any():
        moved = np.where(mine, limited.setpoints, 0.0)
        reasons.append(near_limit(moved, rules.limits, names, bounds))
    else:
        reasons.append(f"{at_limit(full, rules.limits, names, bounds)} are left out")
    # A change that was shortened is not what the policy asked for: nothing winds up.
    settled = limited.scale == 1.0 and not full.any()
    told = tuple(filter(None, reasons))
    return Choice(limited, requested, shaken, decision.policy_state, settled, told)
