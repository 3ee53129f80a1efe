"""The answer in a few sentences of an operator's words: cause, device, size, what to do."""

from collections.abc import Sequence

from orbitfb.diagnose.result.blocks import AmbiguousSet, ClosedLoop, Unknown
from orbitfb.diagnose.result.diagnosis import State
from orbitfb.diagnose.result.parts import Cause, Finding, Gap, Shrink
from orbitfb.diagnose.result.quantities import chance, parameter, percent, quantity
from orbitfb.effects.registry import all_effects
from orbitfb.estimation.priors import CERTAIN

_LEAST_TOLD = 0.1
"""Probability of a further cause below which the sentence leaves it to the table [1]."""

RING = "the whole ring"
_ALL = {"bpm": "all BPMs", "corrector": "all correctors"}
"""What a cause without places is at, by what it strikes."""

_TO_DO = {
    "sensor": "Check the reading of {where}: cable, electronics, calibration.",
    "actuator": "Check the power supply and the magnet of {where}.",
    "optics": "Measure the response again, or load effect.toml into the model.",
    "disturbance": "Find what moves the beam at {where}.",
    "noise": "Find what makes the readings of {where} noisy. The response can stay as it is.",
    "timing": "Check trigger and transport of {where}: when data are taken and when they arrive.",
}
"""What to do about a cause, by the link of the chain that it is in."""


def headline(
    state: State | None,
    *,
    gap: Gap | None = None,
    causes: Sequence[Cause] = (),
    shrink: Shrink | None = None,
    closed_loop: ClosedLoop | None = None,
    ambiguous: Sequence[AmbiguousSet] = (),
    unknown: Unknown | None = None,
    effects: int = 0,
    findings: Sequence[Finding] = (),
) -> str:
    """Say what was found.

    Args:
        state: None when the integrity screen failed.
        gap: Where it is known.
        causes: In the order of their weight.
        shrink: How far it shrinks with them.
        closed_loop: What the loop makes of them.
        ambiguous: Sets that the record cannot decide in.
        unknown: What is known of the rest.
        effects: How many kinds of effects were tested.
        findings: Of the integrity screen.
    """
    if state is None:
        failures = [finding.text for finding in findings if finding.severity == "failure"]
        return "The record is not intact, so nothing was estimated: " + "; ".join(failures[:3])
    noise = quantity(None if gap is None or gap.floor_um is None else 1e-6 * gap.floor_um, "m")
    if state == "no_gap":
        return (
            "No gap: the model explains the record down to its noise. A prediction one row ahead "
            f"is wrong by {noise} rms from noise alone. No effect is needed."
        )
    parts = [
        _named(cause, first=number == 0)
        for number, cause in enumerate(causes)
        if number == 0 or cause.probability is None or cause.probability >= _LEAST_TOLD
    ]
    if state == "named" and any(_is_doubtful(cause) for cause in causes[:1]):
        parts.append(
            "The evidence is weak: a law that is in no library may look like it. A longer record, "
            "or one with test excitation, would tell."
        )
    if state == "ambiguous":
        sets = "; ".join(" and ".join(map(member, one.effects)) for one in ambiguous)
        splits = next((one.splits for one in ambiguous if one.splits), "").rstrip(".")
        parts.append(f"The record cannot decide between {sets}.")
        parts.append(f"What would decide: {splits}." if splits else "")
    if state in ("unknown", "named_plus_remainder"):
        parts.append(_unknown(state, unknown, effects))
    if causes:
        parts.append(to_do(causes[0]))
    if causes and gap is not None and gap.um:
        parts.append(_size(gap, shrink, noise))
    parts.append(_loop(closed_loop))
    return " ".join(part for part in parts if part)


def member(effect: str) -> str:
    """Name a member of an ambiguous set for people."""
    return "nothing at all" if effect == "no_gap" else effect


def describe(cause: Cause) -> str:
    """Name an effect with its places, values, onset and probability."""
    title = cause.title or cause.effect
    text = f"{title[:1].upper()}{title[1:]}"
    where = where_is(cause)
    text += f" on {where}" if where != RING else ""
    told = [
        f"{name} {parameter(value)}"
        for name, value in cause.parameters.items()
        if value.value is not None
    ]
    if told:
        differ = " (the largest of them)" if len(cause.by_place) > 1 else ""
        differ = f" rms over all of them{_largest(cause)}" if cause.scatter else differ
        text += f": {', '.join(told)}{differ}"
    if cause.onset_s is not None:
        text += f", from {cause.onset_s:.4g} s on"
    if cause.probability is not None:
        text += f", probability {chance(cause.probability)}"
    return text


def _largest(cause: Cause) -> str:
    """Say which device is furthest off, where all are."""
    name, told = next(iter(cause.parameters.items()))
    known = [(one.values.get(name) or 0.0, one) for one in cause.by_place]
    if not known:
        return ""
    value, one = max(known, key=lambda pair: abs(pair[0]))
    return f", the largest {quantity(value, told.unit)} on {', '.join(one.places)}"


def places(cause: Cause, most: int = 4) -> str:
    """Name the places of a cause: its label, or the devices while they are few."""
    if cause.label or not cause.places:
        return cause.label
    shown = ", ".join(cause.places[:most])
    rest = len(cause.places) - most
    return f"{shown} and {rest} more" if rest > 0 else shown


def where_is(cause: Cause, most: int = 4) -> str:
    """Name the places of a cause, also where they are all devices or the ring."""
    kind = all_effects().get(cause.effect)
    return places(cause, most) or _ALL.get(kind.target if kind else "", RING)


def to_do(cause: Cause) -> str:
    """Say what to do about a cause."""
    kind = all_effects().get(cause.effect)
    if cause.scatter and not (kind and kind.grows):
        return "All devices have errors: measure the response again, or refit the model."
    return _TO_DO[cause.stage].format(where=where_is(cause))


def _is_doubtful(cause: Cause) -> bool:
    return cause.probability is not None and cause.probability <= CERTAIN


def _named(cause: Cause, *, first: bool) -> str:
    likely = cause.probability is None or cause.probability >= 0.5
    begin = "" if first else "And: "
    return f"{begin if likely else 'Perhaps: '}{describe(cause)}."


def _size(gap: Gap, shrink: Shrink | None, noise: str) -> str:
    """What the causes do to a prediction, in µm of orbit, and what is left of that."""
    told = quantity(None if gap.um is None else 1e-6 * gap.um, "m")
    text = (
        f"This adds {told} rms to the error of a prediction one row ahead; "
        f"noise alone makes {noise}"
    )
    if shrink is None or shrink.um is None or not shrink.resolved:
        return f"{text}."
    on = "" if shrink.on == "the record itself" else f" on {shrink.on}"
    gone = percent(shrink.um, shrink.um_low, shrink.um_high)
    return f"{text}. A model with the cause removes {gone} of the added error{on}."


def _loop(loop: ClosedLoop | None) -> str:
    if loop is None or loop.without_um is None or loop.measured_um is None:
        return ""
    without, now = (quantity(1e-6 * x, "m") for x in (loop.without_um, loop.measured_um))
    if abs(loop.without_um - loop.measured_um) < 0.01 * loop.measured_um:
        return f"The loop holds the orbit to {now} rms; without the cause it would do no better."
    return f"The loop holds the orbit to {now} rms; without the cause it would reach {without}."


def _unknown(state: State, unknown: Unknown | None, effects: int) -> str:
    tested = f"the {effects} effects tested" if effects else "the effects tested"
    begin = (
        f"None of {tested} explains the gap."
        if state == "unknown"
        else f"None of {tested} explains all of the gap alone."
    )
    return f"{begin} {unknown.text}" if unknown is not None and unknown.text else begin
