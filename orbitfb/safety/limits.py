"""The last gate before a write: no setpoint and no step beyond its limit, nothing non-finite."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from orbitfb.core.settings import Settings
from orbitfb.core.signals import Mask, Vector
from orbitfb.safety.bounds import Bounds
from orbitfb.safety.verdict import FINE, Action, Verdict, name_some


class LimitSettings(Settings):
    """Limits of what may be sent."""

    setpoint: float = Field(
        default=17.5,
        gt=0,
        description="Largest |setpoint| [A]; drive limits of the machine that are narrower hold "
        "for their corrector.",
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
    change: Vector,
    setpoints: Vector,
    settings: LimitSettings,
    names: Sequence[str] = (),
    bounds: Bounds | None = None,
) -> Limited:
    """Shorten the whole vector, its direction kept, until every limit holds.

    A setpoint that lies beyond its limit already may only move inwards: an outward element
    shortens the whole change to nothing. One beyond a drive limit may not move at all: the machine
    would have it jump to the limit.

    Args:
        change: Wanted, shape (m,) [A].
        setpoints: In force, shape (m,) [A].
        settings: The limits.
        names: The correctors, for the reason.
        bounds: Where the setpoint of each may be; None: the same for all, by the settings.
    """
    bounds = bounds or Bounds.of(settings.setpoint, len(change))
    none = np.zeros(change.shape, dtype=np.bool_)
    size = np.abs(change)
    peak = float(size.max(initial=0.0))
    if peak <= settings.change_per_tick:  # a NaN does not get through here, nor through the next
        target = setpoints + change
        inside = (target >= bounds.low) & (target <= bounds.high)
        if bool((inside & ~(bounds.stranded(setpoints) & (size > 0.0))).all()):
            return Limited(change, target, 1.0, none, FINE)
    refused = _refusal(change, setpoints, names)
    if not refused.may_act:
        return Limited(np.zeros_like(change), setpoints.copy(), 0.0, none, refused)
    step_scale = settings.change_per_tick / peak if peak > settings.change_per_tick else 1.0
    room = bounds.room(change, setpoints)
    moving = size > 0
    tight = moving & (size * step_scale > room)
    scale = step_scale
    if tight.any():
        scale = min(step_scale, float((room[tight] / size[tight]).min()))
    # Rounding may leave the last bit beyond a limit: clip that bit, never more.
    shortened = np.clip(change * scale, -settings.change_per_tick, settings.change_per_tick)
    low, high = np.minimum(bounds.low, setpoints), np.maximum(bounds.high, setpoints)
    target = np.clip(setpoints + shortened, low, high)
    verdict = _warning(tight, scale, settings, names, bounds)
    return Limited(shortened, target, scale, tight, verdict)


def near_limit(
    setpoints: Vector,
    settings: LimitSettings,
    names: Sequence[str] = (),
    bounds: Bounds | None = None,
) -> str:
    """Say which correctors are close to their limit; empty when none is.

    Args:
        setpoints: Shape (m,) [A].
        settings: The limits.
        names: The correctors.
        bounds: Where the setpoint of each may be; None: the same for all, by the settings.
    """
    bounds = bounds or Bounds.of(settings.setpoint, len(setpoints))
    high, low = (settings.warning * side for side in (bounds.high, bounds.low))
    near = (setpoints > np.maximum(high, 0.0)) | (setpoints < np.minimum(low, 0.0))
    if not near.any():
        return ""
    beyond = f"beyond {settings.warning:.0%} of ±{settings.setpoint:g} A"
    if (near & bounds.drive).any():
        beyond = f"beyond {settings.warning:.0%} of their limits"
    return f"{int(near.sum())} correctors {beyond}: {bounds.name(near, names)}"


def _refusal(change: Vector, setpoints: Vector, names: Sequence[str]) -> Verdict:
    for what, values in (("requested change", change), ("setpoint in force", setpoints)):
        bad = ~np.isfinite(values)
        if bad.any():
            reason = f"the {what} is not finite at {int(bad.sum())} correctors: "
            return Verdict(Action.TRIP, "not_finite", reason + name_some(bad, names))
    return FINE


def at_limit(
    which: Mask, settings: LimitSettings, names: Sequence[str], bounds: Bounds | None = None
) -> str:
    """Say which correctors are at their limit, and at which.

    Args:
        which: Shape (m,).
        settings: The limits.
        names: The correctors.
        bounds: Where the setpoint of each may be; None: the same for all, by the settings.
    """
    count = int(np.count_nonzero(which))
    if bounds is None or not (which & bounds.drive).any():
        return (
            f"{count} correctors at their limit of ±{settings.setpoint:g} A "
            f"({name_some(which, names)})"
        )
    return f"{count} correctors at their drive limits: {bounds.name(which, names)}"


def _warning(
    tight: Mask, scale: float, settings: LimitSettings, names: Sequence[str], bounds: Bounds
) -> Verdict:
    if not tight.any():
        return FINE
    effect = "the loop stands still" if scale == 0 else f"the whole change is scaled by {scale:.2g}"
    reason = f"{at_limit(tight, settings, names, bounds)}: {effect}"
    return Verdict(Action.WARN, "setpoint_limit", reason)
