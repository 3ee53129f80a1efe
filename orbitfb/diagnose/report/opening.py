"""Sections of the page that answer: the card, findings, causes, what to do next."""

from collections.abc import Iterator

from orbitfb.diagnose.result.diagnosis import Diagnosis
from orbitfb.diagnose.result.headline import member, to_do, where_is
from orbitfb.diagnose.result.parts import Cause, Experiment
from orbitfb.diagnose.result.quantities import chance, parameter, percent, quantity
from orbitfb.html.page import (
    folded,
    listed,
    missing,
    paragraph,
    section,
    table,
    text,
)

_STATES = {
    "no_gap": ("no gap", "good"),
    "named": ("cause found", "blue"),
    "ambiguous": ("one of several causes", "doubt"),
    "named_plus_remainder": ("cause found, a part remains", "blue"),
    "unknown": ("cause unknown", "odd"),
    None: ("record not intact", "bad"),
}
_SEVERITIES = {"failure": "bad", "warning": "doubt", "note": "soft"}


def card(its: Diagnosis) -> str:
    """Write the answer with the figures below it."""
    word, colour = _STATES[its.state]
    tiles = "".join(
        f'<div class="tile"><b>{text(value)}</b><span>{text(name)}</span></div>'
        for name, value in _tiles(its)
    )
    return (
        f'<div class="card" style="--badge: var(--{colour})"><span class="badge">{word}</span>'
        f'<p class="said">{text(its.headline)}</p></div>'
        + (f'<div class="tiles">{tiles}</div>' if tiles else "")
    )


def _tiles(its: Diagnosis) -> Iterator[tuple[str, str]]:
    if its.causes:
        yield "where", where_is(its.causes[0], 2)
        yield "probability", chance(its.causes[0].probability)
    if its.gap is not None and its.gap.um:
        yield "orbit error that it adds, row to row", micrometres(its.gap.um)
    if its.shrink is not None and its.shrink.resolved:
        yield "of it removed by a model with the cause", percent(its.shrink.um)
    loop = its.closed_loop
    if loop is not None and loop.without_um is not None:
        yield "orbit in the loop now", micrometres(loop.measured_um)
        yield "without the cause", micrometres(loop.without_um)
    if its.gap is not None:
        yield "noise of a prediction", micrometres(its.gap.floor_um)


def micrometres(value: float | None) -> str:
    """Write a length that is told in µm."""
    return quantity(None if value is None else 1e-6 * value, "m")


def findings(its: Diagnosis) -> str:
    """Write what the integrity screen found, worst first."""
    if not its.findings:
        return paragraph("The integrity screen found nothing.", "note")
    order = list(_SEVERITIES)
    told = sorted(its.findings, key=lambda one: order.index(one.severity))
    lines = []
    for one in told:
        rows = "" if one.rows is None else f" Rows {one.rows[0]} to {one.rows[1]}."
        said = one.text[:1].upper() + one.text[1:]
        said = said if said.endswith((".", "?", "!")) else f"{said}."
        proof = f" Proves <code>{text(one.effect)}</code>." if one.effect else ""
        lines.append(
            f'<p class="finding" style="--badge: var(--{_SEVERITIES[one.severity]})">'
            f"<b>{one.severity}</b> {text(said)}{rows}{proof}</p>"
        )
    return "<h3>About the record itself</h3>" + "".join(lines)


def causes(its: Diagnosis) -> str:
    """Write the causes, the ambiguous sets and what is known of the unknown."""
    pieces = [_cause(cause) for cause in its.causes]
    for one in its.ambiguous:
        why = f": {text(one.why)}" if one.why else ""
        pieces.append(
            paragraph(
                f"<b>Cannot be told apart:</b> {listed(tuple(map(member, one.effects)))}{why}. "
                + (f"What would decide: {text(one.splits.rstrip('.'))}." if one.splits else "")
            )
        )
    pieces.append(_unknown(its))
    if not any(pieces):
        pieces.append(paragraph("No cause is named."))
    return section("causes", "Causes and what to do", *pieces)


def _cause(cause: Cause) -> str:
    where = text(cause.label) or listed(cause.places) or where_is(cause)
    onset = "since before the record" if cause.onset_s is None else f"from {cause.onset_s:.4g} s on"
    facts = [where, onset]
    if cause.probability is not None:
        facts.append(f"probability {chance(cause.probability)}")
    rows = [(text(name), text(parameter(v))) for name, v in cause.parameters.items()]
    head = "rms over all devices" if cause.scatter else "value, 90 % interval"
    others = (
        paragraph(f"May also be: {listed(cause.alternatives)}.", "note")
        if cause.alternatives
        else ""
    )
    near = (
        paragraph(f"Other places not excluded: {listed(cause.places_within)}.")
        if cause.places_within
        else ""
    )
    return (
        f"<h3>{text(_upper(cause.title or cause.effect))} <code>{text(cause.effect)}</code></h3>"
        + paragraph(f"{'; '.join(facts)}.")
        + paragraph(f"<b>What to do.</b> {text(to_do(cause))}")
        + (table(("parameter", head), rows) if rows else "")
        + _each(cause)
        + near
        + others
        + paragraph(text(cause.sentence), "note")
    )


def _each(cause: Cause) -> str:
    """Values device by device."""
    if not cause.by_place:
        return ""
    units = {name: value.unit for name, value in cause.parameters.items()}
    rows = [
        (
            listed(one.places) or "all",
            text(", ".join(f"{k} {quantity(v, units.get(k, '1'))}" for k, v in one.values.items())),
            "" if one.onset_s is None else f"from {one.onset_s:.4g} s on",
        )
        for one in cause.by_place
    ]
    return folded(f"values of {len(rows)} devices", table(("device", "values", ""), rows))


def _upper(words: str) -> str:
    return words[:1].upper() + words[1:]


def _unknown(its: Diagnosis) -> str:
    rest = its.unknown
    if rest is None:
        return ""
    pieces = [
        "<h3>What no effect explains</h3>",
        paragraph(text(rest.text)),
        paragraph(f"Where: {listed(rest.places)}." if rest.places else "Where: not resolved."),
    ]
    if rest.nearest:
        pieces.append(paragraph(f"Nearest in the library: <code>{text(rest.nearest)}</code>."))
    if rest.explained:
        pieces.append(paragraph(f"The causes explain {percent(rest.explained)} of the gap."))
    return "".join(pieces)


def experiment(its: Diagnosis) -> str:
    """Write the card of the recommended experiment."""
    title = "Recommended experiment"
    if its.experiment is None:
        why = "" if its.state == "ambiguous" else "there are no rival causes to tell apart"
        return section("experiment", title, missing("An experiment", why))
    plan = its.experiment
    rows = [(name, value) for name, value in _plan(plan) if value]
    return section(
        "experiment",
        title,
        f'<div class="card" style="--badge: var(--good)"><span class="badge">{text(plan.kind)}'
        f'</span><p class="said">{text(plan.text)}</p></div>',
        table(("", ""), rows),
    )


def _plan(plan: Experiment) -> Iterator[tuple[str, str]]:
    yield "tells apart", listed(plan.splits)
    yield "devices", listed(plan.devices)
    yield "singular modes, from 0", ", ".join(str(mode) for mode in plan.modes)
    if plan.amplitude is not None:
        yield "largest change of a setpoint", quantity(plan.amplitude, "A")
    if plan.orbit_cost_um is not None:
        yield "orbit that it makes, rms", micrometres(plan.orbit_cost_um)
    if plan.minutes is not None:
        yield "beam time", f"{plan.minutes:.3g} min"
    yield "limits", text(plan.limits)
    command = f"<code>orbitfb run --ioc sim --excite {text(plan.file)}</code>"
    yield "try it on the simulated ring first", command if plan.file else ""
