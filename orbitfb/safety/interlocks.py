"""Interlocks that look at one tick alone. A NaN never passes a comparison as fine."""

from collections.abc import Mapping, Sequence

import numpy as np
from pydantic import Field

from orbitfb.core.settings import Settings
from orbitfb.core.signals import Mask, Vector
from orbitfb.safety.verdict import FINE, Action, Verdict, name_some


class InterlockSettings(Settings):
    """Thresholds of the interlocks."""

    current_min: float | None = Field(
        default=0.01,
        ge=0,
        description="Least stored current [A]; none = do not look at the current.",
    )
    current_channel: str = Field(
        default="current", description="Auxiliary channel that carries the stored current."
    )
    distortion_rms: float = Field(default=1e-3, gt=0, description="Largest rms orbit error [m].")
    distortion_max: float = Field(
        default=3e-3, gt=0, description="Largest |orbit error| at a BPM [m]."
    )
    max_invalid_bpms: int = Field(
        default=9,
        ge=0,
        description="BPMs that may be invalid (they are left out), besides those of `masks.bpms`; "
        "more hold the loop.",
    )
    readback_tolerance: float | None = Field(
        default=0.1,
        gt=0,
        description="Largest |readback − setpoint| [A]; none = do not look at it.",
    )
    readback_ticks: int = Field(
        default=3, ge=1, description="Ticks in a row that a corrector may not follow before HELD."
    )
    readback_lag: int = Field(
        default=2,
        ge=0,
        le=100,
        description="Ticks by which a readback may lag behind its setpoint.",
    )
    divergence_ticks: int = Field(
        default=5, ge=2, description="Ticks in a row that the rms must grow to count as divergence."
    )
    divergence_factor: float = Field(
        default=2.0,
        ge=1,
        description="Growth of the rms over that stretch from which the loop trips.",
    )
    divergence_floor: float = Field(
        default=5e-6, ge=0, description="Rms [m] below which growth is taken for noise."
    )
    frozen_ticks: int = Field(
        default=1,
        ge=0,
        description="Repeats of all readings in a row from which the orbit counts as frozen; "
        "0 = never (a simulated ring without noise).",
    )


def stored_current(
    auxiliary: Mapping[str, float],
    settings: InterlockSettings,
    unknown: Action = Action.TRIP,
) -> Verdict:
    """Ask for enough stored current.

    Args:
        auxiliary: Slow channels, SI.
        settings: Thresholds.
        unknown: What to ask for when the current is not known (a machine that is coming back
            has not told it yet, which is no reason to latch).
    """
    if settings.current_min is None:
        return FINE
    current = auxiliary.get(settings.current_channel, float("nan"))
    if current >= settings.current_min:
        return FINE
    if not np.isfinite(current):
        reason = f"the stored current ({settings.current_channel}) is not known"
        return Verdict(unknown, "stored_current", reason)
    reason = (
        f"stored current {current * 1e3:.3g} mA is below the {settings.current_min * 1e3:.3g} mA "
        "that the loop needs"
    )
    return Verdict(Action.TRIP, "stored_current", reason)


def bpm_quota(
    valid: Mask,
    settings: InterlockSettings,
    names: Sequence[str] = (),
    counting: Mask | None = None,
) -> Verdict:
    """Let a few BPMs be invalid, not more, and never all of them.

    Args:
        valid: Shape (n,).
        settings: Thresholds.
        names: The BPMs, for the reason.
        counting: BPMs that are not masked by configuration, shape (n,): what the others read does
            not matter, so they do not use up the quota; None: all.
    """
    bad = ~valid if counting is None else counting & ~valid
    invalid = int(np.count_nonzero(bad))
    if invalid == 0:
        return FINE
    wanted = len(valid) if counting is None else int(np.count_nonzero(counting))
    reason = f"{invalid} of {wanted} BPMs are invalid: {name_some(bad, names)}"
    if invalid <= settings.max_invalid_bpms and invalid < wanted:
        return Verdict(Action.WARN, "bpm_quota", reason)
    return Verdict(Action.HOLD, "bpm_quota", f"{reason}; allowed: {settings.max_invalid_bpms}")


def orbit_distortion(rms: float, largest: float, settings: InterlockSettings) -> Verdict:
    """Keep the orbit error within its limits.

    Args:
        rms: Of the orbit error over the valid BPMs [m].
        largest: |orbit error| over the valid BPMs [m].
        settings: Thresholds.
    """
    for what, value, most in (
        ("rms", rms, settings.distortion_rms),
        ("largest", largest, settings.distortion_max),
    ):
        if not value <= most:
            reason = f"{what} orbit error {value * 1e6:.4g} µm exceeds {most * 1e6:.4g} µm"
            return Verdict(Action.TRIP, "orbit_distortion", reason)
    return FINE


def not_following(readback: Vector, recent: Sequence[Vector], settings: InterlockSettings) -> Mask:
    """Find correctors whose readback is not where its setpoint is or just was.

    A readback on its way between the last few setpoints follows; a NaN does not.

    Args:
        readback: Shape (m,) [A].
        recent: Setpoints in force at this orbit and at the ones before, newest first [A].
        settings: Thresholds.

    Returns:
        Shape (m,).
    """
    if settings.readback_tolerance is None:
        return np.zeros(readback.shape, dtype=np.bool_)
    low = high = recent[0]
    for earlier in recent[1 : settings.readback_lag + 1]:
        low = np.minimum(low, earlier)
        high = np.maximum(high, earlier)
    tolerance = settings.readback_tolerance
    return ~((readback >= low - tolerance) & (readback <= high + tolerance))
