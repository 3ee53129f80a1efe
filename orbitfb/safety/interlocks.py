"""Interlocks that look at one tick alone. A NaN never passes a comparison as fine."""

from collections.abc import Mapping, Sequence

import numpy as np
from pydantic import Field

from orbitfb.core.settings import Settings
from orbitfb.core.signals import Mask, Vector
from orbitfb.safety.verdict import FINE, Action, Verdict


class InterlockSettings(Settings):
    """Thresholds of the interlocks."""

    current_min: float | None = Field(
        default=0.01,
        ge=0,
        description="Lowest stored current [A]; false = not checked.",
    )
    current_drop: float = Field(
        default=0.2,
        gt=0,
        le=1,
        description="Share of the stored current whose loss from one orbit to the next trips the "
        "loop; 1 = never.",
    )
    current_channel: str = Field(
        default="current", description="Auxiliary channel that carries the stored current."
    )
    fast_feedback_channel: str = Field(
        default="",
        description="Auxiliary channel that is not 0 while a fast orbit feedback is closed; empty: "
        "there is none that moves the same correctors.",
    )
    distortion_rms: float = Field(default=1e-3, gt=0, description="Largest rms orbit error [m].")
    distortion_max: float = Field(
        default=3e-3, gt=0, description="Largest |orbit error| at a BPM [m]."
    )
    distortion_rate: float | None = Field(
        default=5e-4,
        gt=0,
        description="Fastest growth of the rms orbit error while the loop is closed, over about "
        "a second [m/s]; false = not checked.",
    )
    max_invalid_bpms: int = Field(
        default=9,
        ge=0,
        description="Most invalid BPMs that are left out, in addition to `masks.bpms`; more hold "
        "the loop.",
    )
    max_adjacent_bpms: int = Field(
        default=2,
        ge=1,
        description=("Most invalid BPMs next to each other along the ring; more hold the loop."),
    )
    bpm_zero: bool = Field(
        default=True,
        description="Whether a reading of exactly 0 is invalid (a dead channel). If the last "
        "digit of a BPM is as large as its noise, only a reading that stays 0 is "
        "invalid.",
    )
    bpm_frozen_ticks: int = Field(
        default=2,
        ge=0,
        description="Number of equal readings in a row, while others change, after which a BPM "
        "is left out; 0 = never. A BPM that often repeats itself, because its last "
        "digit is as large as its noise, may repeat more often. Used only if "
        "`frozen_ticks` is not 0.",
    )
    bpm_jump: float = Field(
        default=250e-6,
        gt=0,
        description="Step of the orbit error at one BPM, ten times that of the others, from "
        "which it is left out until it reads its former value again [m].",
    )
    bpm_proving: int = Field(
        default=5,
        ge=1,
        description="Good readings in a row after which a BPM that was left out counts again.",
    )
    max_lost_correctors: int = Field(
        default=3,
        ge=0,
        description=(
            "Most correctors that are left out because they do not follow; more trip the loop."
        ),
    )
    readback_tolerance: float | None = Field(
        default=0.1,
        gt=0,
        description="Largest |readback − setpoint| [A]; false = not checked.",
    )
    readback_ticks: int = Field(
        default=3,
        ge=1,
        description="Ticks in a row without following after which a corrector is left out.",
    )
    readback_lag: int = Field(
        default=2,
        ge=0,
        le=100,
        description="Ticks by which a readback may lag behind its setpoint.",
    )
    prediction_ticks: int = Field(
        default=3,
        ge=0,
        description="Number of changes in a row to which the orbit does not respond as the "
        "response matrix predicts, while the orbit error does not shrink, that trips "
        "the loop; 0 = never.",
    )
    prediction_least: float = Field(
        default=0.3,
        gt=-1,
        lt=1,
        description="Smallest share of the predicted response that must be seen.",
    )
    prediction_floor: float = Field(
        default=2e-6,
        gt=0,
        description="Rms of a predicted response below which it is not tested [m].",
    )
    divergence_ticks: int = Field(
        default=5, ge=2, description="Ticks in a row with growing rms that count as divergence."
    )
    divergence_factor: float = Field(
        default=2.0,
        ge=1,
        description="Growth of the rms over these ticks that trips the loop.",
    )
    divergence_floor: float = Field(
        default=5e-6,
        ge=0,
        description="Rms below which growth may be noise [m]: the loop does not trip, and only "
        "ticks count that grow by their share of the factor.",
    )
    answer_reach: float | None = Field(
        default=10e-6,
        gt=0,
        description="Orbit that the loop may make at a BPM or by a corrector without a visible "
        "response, before it tests the response by random excursions [m]; false = "
        "never test it.",
    )
    answer_question: float = Field(
        default=0.5e-6,
        ge=0,
        description="Largest orbit by such excursions, rms over the BPMs [m]; 0 = no excursions: "
        "then only large steps of the loop show a response.",
    )
    answer_after: float = Field(
        default=60.0,
        gt=0,
        description="Time without a visible response after which the loop also tests it [s].",
    )
    second_controller_ticks: int = Field(
        default=10,
        ge=0,
        description="Orbits at which somebody else moved more than max_lost_correctors of the "
        "loop's correctors, from which that counts as a second controller and the loop trips; each "
        "orbit without such moves takes off half of one; 0 = never (setpoints that move by "
        "themselves).",
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
    before: float = float("nan"),
    why: Mapping[str, str] | None = None,
) -> Verdict:
    """Ask for enough stored current, and that it does not drop.

    Args:
        auxiliary: Slow channels, SI.
        settings: Thresholds.
        unknown: What to ask for when the current is not known (a machine that is coming back
            has not told it yet, which is no reason to latch).
        before: Stored current at the orbit before [A]; NaN: not known.
        why: Why slow channels are not known, by name.
    """
    if settings.current_min is None:
        return FINE
    current = auxiliary.get(settings.current_channel, float("nan"))
    if current >= settings.current_min:
        if settings.current_drop < 1 and current < (1 - settings.current_drop) * before:
            reason = f"the stored current dropped from {before * 1e3:.4g} to {current * 1e3:.4g} mA"
            return Verdict(Action.TRIP, "stored_current", reason)
        return FINE
    if not np.isfinite(current):
        cause = (why or {}).get(settings.current_channel, "")
        reason = f"the stored current ({settings.current_channel}) is not known"
        reason += f": {cause}" if cause else ""
        return Verdict(unknown, "stored_current", reason)
    reason = (
        f"stored current {current * 1e3:.3g} mA is below the {settings.current_min * 1e3:.3g} mA "
        "that the loop needs"
    )
    return Verdict(Action.TRIP, "stored_current", reason)


def fast_feedback(
    auxiliary: Mapping[str, float],
    settings: InterlockSettings,
    why: Mapping[str, str] | None = None,
) -> Verdict:
    """Leave the beam to a fast feedback as long as it is closed: two loops fight each other.

    Args:
        auxiliary: Slow channels, SI.
        settings: Which of them is its status.
        why: Why slow channels are not known, by name.
    """
    channel = settings.fast_feedback_channel
    if not channel:
        return FINE
    status = auxiliary.get(channel, float("nan"))
    if status == 0.0:
        return FINE
    reason = f"the fast feedback is closed ({channel} is {status:g})"
    if not np.isfinite(status):
        cause = (why or {}).get(channel, "")
        reason = f"whether the fast feedback is closed ({channel}) is not known"
        reason += f": {cause}" if cause else ""
    return Verdict(Action.HOLD, "fast_feedback", reason)


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
