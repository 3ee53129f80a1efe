"""Who decides: the policy in force, or the baseline when that fails; without which correctors."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.ports import Clock, Policy, inform, take_back
from orbitfb.core.signals import Mask, Vector
from orbitfb.estimation.columns import KnownRf
from orbitfb.loop.slot import PolicySlot
from orbitfb.loop.tick import Checked, decide
from orbitfb.safety.bounds import Bounds

Without = Callable[[Policy, Mask], Policy]
"""Makes of a policy one that does not move some correctors, shape (m,), the rest solved anew."""

STRIKES = 3
"""Ticks in a row at which a policy is late before the baseline takes over for good."""
_KEPT = 16


@dataclass(frozen=True, slots=True)
class Safeguards:
    """What there is to fall back on.

    Args:
        fallback: The baseline, that decides when the policy in force does not; None: there is
            none, and a policy that fails stops the loop.
        without: See `Without`; None: no corrector can be left out.
        obstacle: Says why the machine must not be written to; asked before the loop closes; empty
            when it may.
        drive_limits: Gives those that the machine states now, shape (m, 2), low and high [A]; NaN:
            none; None: the machine states none.
    """

    fallback: Policy | None = None
    without: Without | None = None
    obstacle: Callable[[], str] = str
    drive_limits: Callable[[], NDArray[np.float64]] | None = None


NONE = Safeguards()
"""Nothing to fall back on: a policy that fails stops the loop."""


@dataclass(frozen=True, slots=True)
class Decision:
    """A change that is wanted.

    Args:
        change: Shape (m,) [A].
        policy_state: New state of the policy in force.
        alarm: Why the policy in force did not decide; empty when it did.
    """

    change: Vector
    policy_state: Any
    alarm: str = ""


class Guard:
    """Holds the policy in force and asks it; the baseline steps in within the same tick.

    Args:
        slot: Where the policy in force lies.
        safeguards: What there is to fall back on.
        clock: Monotonic clock.
        deadline: How long a policy may take for a tick, to decide and to learn [s].

    Attributes:
        policy: The one that decides.
        alarm: Why that is not the one in the slot; empty when it is.
    """

    def __init__(
        self, slot: PolicySlot, safeguards: Safeguards, clock: Clock, deadline: float
    ) -> None:
        self._slot, self._clock, self._deadline = slot, clock, deadline
        self._fallback, self._without = safeguards.fallback, safeguards.without
        self.obstacle, self._drive_limits = safeguards.obstacle, safeguards.drive_limits
        self._taken = slot.acting
        self._swaps: int = slot.swaps
        self._late, self._learning = 0, 0.0
        self._solved: dict[tuple[int, bytes], tuple[Policy, Policy]] = {}
        self.policy: Policy = self._taken
        self.alarm = ""

    @property
    def can_leave_out(self) -> bool:
        """Whether correctors can be left out."""
        return self._without is not None

    def take(self) -> bool:
        """Take the policy of the slot if it is another one; say whether it is."""
        swaps, acting = self._slot.swaps, self._slot.acting
        if acting is self._taken and swaps == self._swaps:
            return False
        changed = acting is not self.policy
        self._taken, self._swaps = acting, swaps
        self._use(acting, "")
        return changed

    def forgive(self) -> None:
        """Give the policy of the slot another chance: an operator closes the loop."""
        if self.alarm:
            self._use(self._taken, "")

    def movable(self, correctors: int) -> Mask:
        """Correctors that may move, shape (m,), whoever decides.

        Which are disabled is told by the policy of the slot; the baseline does not know.
        """
        mask = np.ones(correctors, dtype=np.bool_)
        for policy in (self._taken, self.policy):
            own: Mask | None = getattr(policy, "movable", None)
            if own is not None:
                mask &= own
        return mask

    def bounds(self, limit: float, correctors: int) -> Bounds:
        """Say where the setpoint of each corrector may be now.

        Args:
            limit: Largest |setpoint| of all [A].
            correctors: m.
        """
        drive = None if self._drive_limits is None else self._drive_limits()
        return Bounds.of(limit, correctors, drive)

    @property
    def response(self) -> Vector | None:
        """The policy's response matrix, shape (n, m) [m/A]; None: it has none."""
        return getattr(self.policy, "response", None)

    @property
    def rf(self) -> KnownRf | None:
        """What the policy knows of the RF; None: nothing."""
        return getattr(self.policy, "rf", None)

    def predict(self, change: Vector) -> Vector | None:
        """Give what a change does to the orbit by the policy's matrix, shape (n,) [m]."""
        response = self.response
        return None if response is None else response @ change

    def decide(self, checked: Checked, policy_state: Any, lost: Mask) -> Decision:
        """Ask the policy in force, and the baseline if that raises, is late or not finite.

        A policy that decides in time but learns too long is late as well: the next orbit waits.

        Args:
            checked: The orbit error and what of it counts.
            policy_state: Of the policy in force.
            lost: Correctors to leave out, shape (m,).

        Raises:
            ValueError: The policy returned another shape, and there is no baseline.
        """
        began = self._clock.monotonic()
        fallback = self._fallback
        if fallback is None or self.policy is fallback:
            return Decision(
                *decide(self._leaving(self.policy, lost), checked, policy_state, len(lost))
            )
        try:
            change, after = decide(
                self._leaving(self.policy, lost), checked, policy_state, len(lost)
            )
        except Exception as error:  # a policy may raise anything: the baseline decides instead
            trouble = f"raised {type(error).__name__}: {error}"
        else:
            took, deadline = self._clock.monotonic() - began, self._deadline
            whole, self._learning = took + self._learning, 0.0
            if not np.isfinite(change).all():
                trouble = "asked for a change that is not finite"
            else:
                self._late = self._late + 1 if whole > deadline else 0
                if took <= deadline and self._late < STRIKES:
                    return Decision(change, after)
                what = "to decide" if took > deadline else "to learn and decide"
                trouble = f"took {whole * 1e3:.3g} ms {what}, longer than {deadline * 1e3:.3g} ms"
        alarm = f"policy {self.policy.policy_id} {trouble}: {fallback.policy_id} decides"
        state = fallback.initial_state()
        change, after = decide(self._leaving(fallback, lost), checked, state, len(lost))
        if trouble.startswith("took") and self._late < STRIKES:
            return Decision(change, policy_state, alarm)  # once more, then it is put aside
        self._use(fallback, alarm)
        return Decision(change, after, alarm)

    @property
    def learns_rf(self) -> bool:
        """Whether the policy wants to know of steps of the RF."""
        return bool(getattr(self.policy, "learns_rf", False))

    def inform(
        self, checked: Checked, applied: Vector, policy_state: Any, hertz: float = 0.0
    ) -> Any:
        """Tell a policy that learns what was sent; one that fails at it decides no more.

        Args:
            checked: The orbit error that was decided on.
            applied: Change of setpoints as it was sent, shape (m,) [A].
            policy_state: Of the policy in force.
            hertz: Step of the RF that went with it, for one that learns of it [Hz].

        Returns:
            The state for the next decision.
        """
        policy, fallback = self.policy, self._fallback
        began = self._clock.monotonic()
        try:
            after = inform(policy, checked.error, checked.valid, applied, policy_state, hertz)
        except Exception as error:  # a policy may raise anything: the baseline decides instead
            if fallback is None or policy is fallback:
                raise
            trouble = f"could not learn, {type(error).__name__}: {error}"
            self._use(
                fallback, f"policy {policy.policy_id} {trouble}: {fallback.policy_id} decides"
            )
            return fallback.initial_state()
        self._learning = self._clock.monotonic() - began
        return after

    def tripped(self) -> None:
        """Let the policy in force forget what it learnt shortly before the loop tripped."""
        take_back(self.policy)

    def _use(self, policy: Policy, alarm: str) -> None:
        self.policy, self.alarm = policy, alarm
        self._late, self._learning = 0, 0.0
        self._solved.clear()

    def _leaving(self, policy: Policy, lost: Mask) -> Policy:
        if policy is not self._taken:
            lost = lost | ~self.movable(len(lost))
        if self._without is None or not lost.any():
            return policy
        key = id(policy), lost.tobytes()
        known = self._solved.get(key)
        if known is None or known[0] is not policy:
            if len(self._solved) >= _KEPT:
                self._solved.clear()
            known = self._solved[key] = policy, self._without(policy, lost)
        return known[1]
