"""What a correction by hand would be: the change, and the orbit that is expected after it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from orbitfb.app.commands.known_response import KnownResponse
from orbitfb.app.commands.preview import Latest
from orbitfb.core.errors import ControlError, OrbitFeedbackError
from orbitfb.core.ports import Policy
from orbitfb.core.signals import Channels, Mask, Vector
from orbitfb.learn.builders import masked, unmasked
from orbitfb.loop.adjustments import Adjustments
from orbitfb.loop.choice import ROUNDS
from orbitfb.loop.correction.move import Move
from orbitfb.loop.correction.settings import CorrectionSettings
from orbitfb.loop.runner import Runner
from orbitfb.loop.slot import PolicySlot
from orbitfb.panel.pvs.corrections import LAWS
from orbitfb.policies.masking import without
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.bounds import Bounds

BASELINE, ACTIVE = LAWS
"""The SVD law with gain 1, or the policy in force as it is."""


@dataclass(frozen=True, slots=True)
class Sources:
    """What a correction is computed from.

    Args:
        channels: Of the loop.
        runner: The loop.
        slot: The policy in force.
        latest: The last orbit.
        configured: Settings of the SVD law for a policy in force that is none.
        movable: Gives the correctors that may move now, shape (m,).
        bounds: Gives the limits of the setpoints that are in force.
        settings: Of corrections.
        period: Of the loop [s].
        measured: The response that was measured, else that of the policy counts.
    """

    channels: Channels
    runner: Runner
    slot: PolicySlot
    latest: Latest
    configured: SvdSettings
    movable: Callable[[], Mask]
    bounds: Callable[[], Bounds]
    settings: CorrectionSettings
    period: float
    measured: KnownResponse = field(default_factory=KnownResponse)


@dataclass(frozen=True, slots=True)
class Preview:
    """A correction that was computed.

    Args:
        move: What it would do.
        now: Rms orbit error before it [m].
        made: When, monotonic [s].
        wanted: What operators wanted then.
        left_out: Correctors that stay as they would go beyond their limits; empty: none.
    """

    move: Move
    now: float
    made: float
    wanted: Adjustments
    left_out: str

    @property
    def change(self) -> Vector:
        """Change of the setpoints, shape (m,) [A]."""
        return self.move.aim - self.move.start


def compute(sources: Sources, kind: str, now: float) -> Preview:
    """Compute a correction of an open loop.

    Args:
        sources: What it is computed from.
        kind: The law, one of `LAWS`.
        now: Monotonic [s].

    Raises:
        ControlError: There is no fresh orbit, the setpoints are not known, or the correction would
            go beyond limits or make the orbit worse.
        OrbitFeedbackError: The law asks for changes that are not finite.
    """
    error, valid = sources.latest.error
    record = sources.latest.record
    if record is None or record.reading is None or not valid.any():
        raise ControlError("correct refused: no BPM of the last orbit counts")
    oldest = max(2.0, 3.0 * sources.period)
    if (age := now - record.reading.received) > oldest:
        raise ControlError(f"correct refused: the last orbit came {age:.3g} s ago")
    start = record.setpoints + record.applied
    if not np.isfinite(start).all():
        raise ControlError("correct refused: the setpoints in force are not known")
    policy = _law(sources, kind)
    change, full = _solved(sources, policy, error, valid, start)
    before, after = rms_of(error[valid]), rms_of(expected(sources, error, change)[valid])
    name = f"correction by {policy.policy_id}"
    if not after < before:
        raise ControlError(
            f"{name} refused: the orbit error is {before * 1e6:.3g} µm rms and would be "
            f"{after * 1e6:.3g} µm after it"
        )
    left_out = sources.bounds().name(full, sources.channels.correctors) if full.any() else ""
    move = Move(name, start, start + change, after)
    wanted = sources.runner.adjustments
    return Preview(move, before, now, wanted, left_out)


def _solved(
    sources: Sources, policy: Policy, error: Vector, valid: Mask, start: Vector
) -> tuple[Vector, Mask]:
    """Solve without the correctors that would go beyond their limits.

    Returns:
        The change, shape (m,) [A], and the correctors that were left out, shape (m,).
    """
    bounds, full = sources.bounds(), np.zeros(len(start), dtype=np.bool_)
    for _ in range(ROUNDS):
        change, _ = policy.act(error, valid, policy.initial_state())
        if change.shape != start.shape or not np.isfinite(change).all():
            raise OrbitFeedbackError(f"{policy.policy_id} asks for changes that are not finite")
        size = np.abs(change)
        tight = (size > bounds.room(change, start)) & (size > 0)
        if not tight.any():
            return change, full
        full |= tight
        if not (sources.movable() & ~full).any():
            break
        policy = without(policy, full)
    names = bounds.name(full, sources.channels.correctors)
    raise ControlError(f"correct refused: {names} would go beyond their limits")


def _law(sources: Sources, kind: str) -> Policy:
    if kind == ACTIVE:
        return sources.slot.acting
    inside: Any = unmasked(sources.slot.current)
    settings = inside.settings if isinstance(inside, SvdPolicy) else sources.configured
    whole = {"gain": 1.0, "integral_gain": 0.0, "derivative_gain": 0.0}
    law = SvdPolicy(
        inside.response,
        settings.model_copy(update=whole),
        covariance=getattr(inside, "covariance", None),
    )
    return masked(law, sources.movable())


def expected(sources: Sources, error: Vector, change: Vector) -> Vector:
    """Give the orbit error after a change, shape (n,) [m], by what is known of the response."""
    response = sources.measured.matrix
    if response is None:
        response = getattr(sources.slot.acting, "response", None)
    if response is None:
        raise ControlError(
            "the policy in force has no response matrix, so that nothing can be predicted"
        )
    return error + response @ change


def rms_of(values: Vector) -> float:
    """Give the root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))
