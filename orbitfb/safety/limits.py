"""The last gate before a write: no setpoint and no step beyond its limit, nothing non-finite."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from orbitfb.core.settings import Settings
from orbitfb.core.signals import Mask, Vector
from orbitfb.safety.verdict import FINE, Action, Verdict, name_some


class LimitSettings(Settings):
    """Limits of what may be sent."""

    setpoint: float = Field(
        default=17.5,
        gt=0,
        description="Largest |setpoint| [A]; below the drive limit of the machine.",
    )
    change_per_tick: float = Field(
        default=2.0, gt=0, description="Largest |change| of a setpoint in one tick [A]."
    )
    warning: float = Field(
        default=0.9,
        gt=0,
        le=1,
        description="Part of the largest |setpoint| from which a corrector is warned of.",
    )


@dataclass(frozen=True, slots=True)
class Limited:
    """A change that may be sent.

    Args:
        change: Shape (m,) [A]; zeros when it was refused.
        setpoints: Where it leads, shape (m,) [A]: what to send.
        scale: Factor by which the whole vector was shortened, 0 to 1.
        at_limit: Correctors whose setpoint limit shortens the change, shape (m,).
        verdict: OK; WARN when a corrector at its limit holds the others back; TRIP when the
            change or a setpoint is not finite.
    """

    change: Vector
    setpoints: Vector
    scale: float
    at_limit: Mask
    verdict: Verdict


def limit(
    change: Vector, setpoints: Vector, settings: LimitSettings, names: Sequence[str] = ()
) -> Limited:
    """Shorten the whole vector, its direction kept, until every limit holds.

    A setpoint that lies beyond its limit already may only move inwards: an outward element
    shortens the whole change to nothing.

    Args:
        change: Wanted, shape (m,) [A].
        setpoints: In force, shape (m,) [A].
        settings: The limits.
        names: The correctors, for the reason.
    """
    none = np.zeros(change.shape, dtype=np.bool_)
    size = np.abs(change)
    peak = float(size.max(initial=0.0))
    if peak <= settings.change_per_tick:  # a NaN does not get through here, nor through the next
        target = setpoints + change
        if float(np.abs(target).max(initial=0.0)) <= settings.setpoint:
            return Limited(change, target, 1.0, none, FINE)
    refused = _refusal(change, setpoints, names)
    if not refused.may_act:
        return Limited(np.zeros_like(change), setpoints.copy(), 0.0, none, refused)
    step_scale = settings.change_per_tick / peak if peak > settings.change_per_tick else 1.0
    room = settings.setpoint - np.where(change < 0, -setpoints, setpoints)
    room = np.maximum(room, 0.0)
    moving = size > 0
    tight = moving & (size * step_scale > room)
    scale = step_scale
    if tight.any():
        scale = min(step_scale, float((room[tight] / size[tight]).min()))
    # Rounding may leave the last bit beyond a limit: clip that bit, never more.
    shortened = np.clip(change * scale, -settings.change_per_tick, settings.change_per_tick)
    low = np.minimum(-settings.setpoint, setpoints)
    high = np.maximum(settings.setpoint, setpoints)
    target = np.clip(setpoints + shortened, low, high)
    return Limited(shortened, target, scale, tight, _warning(tight, scale, settings, names))


def near_limit(setpoints: Vector, settings: LimitSettings, names: Sequence[str] = ()) -> str:
    """Say which correctors are close to their limit; empty when none is.

    Args:
        setpoints: Shape (m,) [A].
        settings: The limits.
        names: The correctors.
    """
    near = np.abs(setpoints) > settings.warning * settings.setpoint
    if not near.any():
        return ""
    beyond = f"beyond {settings.warning:.0%} of ±{settings.setpoint:g} A"
    return f"{int(near.sum())} correctors {beyond}: {name_some(near, names)}"


def too_narrow(settings: LimitSettings, drive: NDArray[np.float64], names: Sequence[str]) -> str:
    """Say that our limit lies beyond the drive limits of the machine; empty if it does not.

    Args:
        settings: Has the limit.
        drive: Drive limits, shape (m, 2), low and high [A]; NaN: none.
        names: The m PVs.
    """
    limit = settings.setpoint
    beyond = np.flatnonzero((drive[:, 0] > -limit) | (drive[:, 1] < limit))
    if not beyond.size:
        return ""
    first = int(beyond[0])
    room = np.minimum(-drive[:, 0], drive[:, 1])
    return (
        f"limits.setpoint is {limit:g} A, but {beyond.size} correctors have narrower drive "
        f"limits, {names[first]} for one: {drive[first, 0]:g} to {drive[first, 1]:g} A; set "
        f"limits.setpoint to {np.nanmin(room):g} A or less"
    )


def _refusal(change: Vector, setpoints: Vector, names: Sequence[str]) -> Verdict:
    for what, values in (("requested change", change), ("setpoint in force", setpoints)):
        bad = ~np.isfinite(values)
        if bad.any():
            reason = f"the {what} is not finite at {int(bad.sum())} correctors: "
            return Verdict(Action.TRIP, "not_finite", reason + name_some(bad, names))
    return FINE


def _warning(tight: Mask, scale: float, settings: LimitSettings, names: Sequence[str]) -> Verdict:
    if not tight.any():
        return FINE
    effect = "the loop stands still" if scale == 0 else f"the whole change is scaled by {scale:.2g}"
    reason = (
        f"{int(tight.sum())} correctors at their limit of ±{settings.setpoint:g} A "
        f"({name_some(tight, names)}): {effect}"
    )
    return Verdict(Action.WARN, "setpoint_limit", reason)
