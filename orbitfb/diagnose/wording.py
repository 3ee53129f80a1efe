"""The answer in one sentence."""

from collections.abc import Sequence

from orbitfb.diagnose.answer import State
from orbitfb.diagnose.answer_blocks import AmbiguousSet, ClosedLoop, Unknown
from orbitfb.diagnose.answer_parts import Cause, Finding, Gap, ParameterValue, Shrink

_LEAST_TOLD = 0.1
"""Probability of a further cause below which the sentence leaves it to the table."""

_NO_CHANGE = 0.005
"""Share of the gap below which a change is written as 0 %."""
_LIKELIER = 0.5
"""Probability from which a law is more likely than not that of the cause."""


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
        shrink: On held-out data.
        closed_loop: Prediction and measurement.
        ambiguous: Sets that the record cannot decide in.
        unknown: What is known of the rest.
        effects: How many kinds of effects were tested.
        findings: Of the integrity screen.
    """
    if state is None:
        failures = [finding.text for finding in findings if finding.severity == "failure"]
        return "The record is not intact, nothing was estimated: " + "; ".join(failures[:3])
    parts = [_gap(gap, state)]
    if state == "no_gap":
        parts.append("No effect is needed to explain the record.")
    elif state in ("named", "named_plus_remainder"):
        parts.append(_named(causes))
        if state == "named_plus_remainder":
            parts.append("A part of the gap remains that no known effect explains.")
            parts.append(unknown.text if unknown is not None else "")
    elif state == "ambiguous":
        sets = ", and ".join(" or ".join(map(member, one.effects)) for one in ambiguous)
        parts.append(f"The record cannot decide: {sets}.")
        if any("no_gap" in one.effects for one in ambiguous):
            parts.append(f"The likeliest is {describe(causes[0])}." if causes else "")
    else:
        parts.append(_unknown(unknown, effects))
    if causes and shrink is not None:
        parts.append(_shrink(shrink))
    if causes and closed_loop is not None and closed_loop.with_um is not None:
        parts.append(
            f"Predicted loop rms {_plain(closed_loop.with_um)} µm, measured "
            f"{_plain(closed_loop.measured_um)}."
        )
    return " ".join(part for part in parts if part)


def member(effect: str) -> str:
    """Name a member of an ambiguous set for people."""
    return "nothing at all" if effect == "no_gap" else effect


def _plain(value: float | None, digits: int = 3) -> str:
    return "not resolved" if value is None else f"{value:.{digits}g}"


def _gap(gap: Gap | None, state: State) -> str:
    if gap is None:
        return ""
    if state == "no_gap" or not gap.resolved or gap.nats_per_tick is None:
        but = "No" if state in ("no_gap", "unknown") else "Apart from what is named no"
        yet = ", yet what is left is no noise of this floor" if state == "unknown" else ""
        return f"{but} gap is resolved over the floor of {_plain(gap.floor_um)} µm{yet}."
    size = _plain(gap.nats_per_tick)
    interval = (
        f" [{_plain(gap.low)}, {_plain(gap.high)}]"
        if gap.low is not None and gap.high is not None and gap.high > gap.low
        else ""
    )
    more = f"{_plain(gap.um)} µm over" if gap.um else "over"  # noise alone makes no orbit
    return f"Gap {size}{interval} nats/tick ({more} the {_plain(gap.floor_um)} µm floor)."


def _named(causes: Sequence[Cause]) -> str:
    """Name the first cause, and of the others those whose law may be theirs."""
    told = [
        cause
        for index, cause in enumerate(causes)
        if index == 0 or cause.probability is None or cause.probability >= _LEAST_TOLD
    ]
    return " ".join(
        f"{_introduced(cause, first=index == 0)}: {describe(cause)}."
        for index, cause in enumerate(told)
    )


def _introduced(cause: Cause, *, first: bool) -> str:
    """Begin a sentence about a cause: what is less likely than not is no more than the nearest."""
    likely = cause.probability is None or cause.probability >= _LIKELIER
    if likely:
        return "Cause" if first else "And"
    return "Nearest known cause" if first else "And perhaps"


def describe(cause: Cause) -> str:
    """Name an effect with its places, parameters, onset and probability."""
    words = [cause.title or cause.effect, f"on {places(cause)}" if places(cause) else ""]
    values = [
        f"{name} = {parameter(value)}"
        for name, value in cause.parameters.items()
        if value.value is not None
    ]
    text = " ".join(word for word in words if word)
    if values:
        text += ", " + ", ".join(values)
    if cause.onset_s is not None:
        text += f", from {cause.onset_s:.4g} s on"
    if cause.probability is not None:
        # never rounded up to a certainty that no record can give
        text += f", P = {min(cause.probability, 0.999):.3g}"
    if len(cause.alternatives) > 0:
        text += f" (or {', '.join(cause.alternatives)})"
    return text


def places(cause: Cause, most: int = 4) -> str:
    """Name the places of a cause: its label, or the devices while they are few."""
    if cause.label or not cause.places:
        return cause.label
    shown = ", ".join(cause.places[:most])
    rest = len(cause.places) - most
    return f"{shown} and {rest} more" if rest > 0 else shown


def parameter(value: ParameterValue) -> str:
    """Write a parameter with its interval and unit."""
    text = _plain(value.value)
    if value.low is not None and value.high is not None:
        text += f" [{_plain(value.low)}, {_plain(value.high)}]"
    text = _with_unit(text, value.unit)
    return f"{text} ({value.meaning})" if value.meaning else text


def quantity(value: float, unit: str) -> str:
    """Write a number with its unit."""
    return _with_unit(_plain(value), unit)


def _with_unit(text: str, unit: str) -> str:
    return text if unit in ("", "1") else f"{text} {unit}"


def _unknown(unknown: Unknown | None, effects: int) -> str:
    text = f"None of the {effects} known effects." if effects else "None of the known effects."
    if unknown is None:
        return text
    likely = max(unknown.stages.items(), key=lambda item: item[1] or 0.0, default=None)
    if likely is not None and likely[1]:
        text += f" It is most likely in the stage {likely[0]} (P = {likely[1]:.2g})"
        text += f", at {', '.join(unknown.places[:4])}." if unknown.places else "."
    text += f" Nearest: {unknown.nearest}." if unknown.nearest else ""
    return f"{text} {unknown.text}" if unknown.text else text


def _shrink(shrink: Shrink) -> str:
    if not shrink.resolved or shrink.nats is None:
        return "How far the gap shrinks is not resolved on the held-out data."
    where = f"On {shrink.on or 'held-out data'} ({shrink.held_out_ticks} ticks) the gap"
    if all(abs(share or 0.0) < _NO_CHANGE for share in (shrink.nats, shrink.low, shrink.high)):
        return f"{where} stays as it is: what is named does not show there."
    verb = "shrinks by" if shrink.nats >= 0 else "grows by"
    ends = ""
    if shrink.low is not None and shrink.high is not None:
        low, high = sorted((_percent(shrink.low, shrink.nats), _percent(shrink.high, shrink.nats)))
        ends = f" [{low:.0f}, {high:.0f}]"
    return f"{where} {verb} {abs(100 * shrink.nats):.0f} %{ends}."


def _percent(share: float, sign_of: float) -> float:
    return 100 * share if sign_of >= 0 else -100 * share
