"""Sections of the page that answer: headline card, causes, experiment, limits, provenance."""

from collections.abc import Iterator

from orbitfb.diagnose.answer import Diagnosis
from orbitfb.diagnose.answer_parts import Cause, Experiment
from orbitfb.diagnose.report.draw import BLUE
from orbitfb.diagnose.report.html import (
    figure_of,
    interval,
    listed,
    missing,
    paragraph,
    percent,
    section,
    sentence,
    table,
    text,
)
from orbitfb.diagnose.wording import member

_STATES = {
    "no_gap": ("no gap", "#00724f"),
    "named": ("cause named", BLUE),
    "ambiguous": ("ambiguous", "#805600"),
    "named_plus_remainder": ("cause named, a part remains", BLUE),
    "unknown": ("unknown cause", "#8a3d6f"),
    None: ("record not intact", "#a33a00"),
}
_SEVERITIES = {"failure": "#a33a00", "warning": "#805600", "note": "#5b6670"}
"""Dark enough to be read as text."""


def card(its: Diagnosis) -> str:
    """Write the headline card with the figures below it."""
    word, colour = _STATES[its.state]
    tiles = "".join(
        f'<div class="tile"><b>{value}</b><span>{name}</span></div>' for name, value in _tiles(its)
    )
    return (
        f'<div class="card" style="--badge: {colour}"><span class="badge">{word}</span>'
        f'<p class="said">{text(its.headline)}</p></div>'
        + (f'<div class="tiles">{tiles}</div>' if tiles else "")
    )


def _tiles(its: Diagnosis) -> Iterator[tuple[str, str]]:
    if its.gap is not None:
        gap = its.gap
        resolved = gap.resolved and gap.nats_per_tick is not None
        size = interval(gap.nats_per_tick, gap.low, gap.high)
        yield "gap [nats/tick]", size if resolved else "not resolved"
        yield "gap, one step [µm]", interval(gap.um, gap.um_low, gap.um_high)
        yield "floor of the noise [µm]", figure_of(gap.floor_um)
    if its.causes:
        found = its.causes[0].probability
        yield "probability", "not resolved" if found is None else f"{min(found, 0.999):.3g}"
    if its.shrink is not None:
        shrink = its.shrink
        yield "shrink on held-out data", percent(shrink.nats if shrink.resolved else None)
    if its.closed_loop is not None:
        loop = its.closed_loop
        yield (
            "orbit rms, predicted / measured [µm]",
            f"{figure_of(loop.with_um)} / {figure_of(loop.measured_um)}",
        )


def findings(its: Diagnosis) -> str:
    """Write what the integrity screen found."""
    if not its.findings:
        return paragraph("The integrity screen found nothing.", "note")
    rows = [
        (
            f'<b style="color: {_SEVERITIES[finding.severity]}">{finding.severity}</b>',
            text(finding.check),
            sentence(finding.text),
            listed(finding.devices) or "all",
            "all" if finding.rows is None else f"{finding.rows[0]}–{finding.rows[1]}",
            text(finding.effect),
        )
        for finding in its.findings
    ]
    heads = ("severity", "check", "what", "devices", "rows", "proves")
    return "<h3>Integrity screen</h3>" + table(heads, rows)


def causes(its: Diagnosis) -> str:
    """Write the causes, the ambiguous sets and what is known of the unknown."""
    pieces = [_cause(cause) for cause in its.causes]
    if its.causes:
        pieces.append(_worth(its))
    for one in its.ambiguous:
        why = f" because: {text(one.why)}" if one.why else ""
        pieces.append(
            paragraph(
                f"<b>Cannot be told apart:</b> {listed(tuple(map(member, one.effects)))}{why}. "
                + (f"What would split them: {text(one.splits.rstrip('.'))}." if one.splits else "")
            )
        )
    pieces.append(_unknown(its))
    if not any(pieces):
        pieces.append(paragraph("No cause is named."))
    return section("causes", "Causes", *pieces)


def _cause(cause: Cause) -> str:
    rows = []
    for name, value in cause.parameters.items():
        doubts = [
            word
            for word, holds in (
                ("at the bound of its range", value.at_bound),
                ("differs between parts of the record", value.unstable),
            )
            if holds
        ]
        rows.append(
            (
                text(name),
                interval(value.value, value.low, value.high, value.unit),
                f'<span class="flag">{", ".join(doubts)}</span>' if doubts else "",
            )
        )
    onset = "always there" if cause.onset_s is None else f"from {cause.onset_s:.4g} s on"
    facts = [f"stage {cause.stage}", onset]
    if cause.probability is not None:
        facts.append(f"P = {min(cause.probability, 0.999):.3g}")
    if cause.departs:
        more = figure_of(cause.departs_nats)
        facts.append(f"its law lacks what goes {cause.departs}: {more} nats")
    if cause.alternatives:
        facts.append(f"its class: {listed((cause.effect, *cause.alternatives))}")
    where = text(cause.label) or listed(cause.places) or "the whole ring"
    names = f" ({listed(cause.places)})" if cause.label and cause.places else ""
    near = (
        paragraph(f"Other places not excluded: {listed(cause.places_within)}.")
        if cause.places_within
        else ""
    )
    return (
        f"<h3>{text(cause.title or cause.effect)} <code>{text(cause.effect)}</code></h3>"
        + paragraph(text(cause.sentence), "note")
        + paragraph(f"{where}{names}; {'; '.join(facts)}.")
        + near
        + (table(("parameter", "value, 90 % interval", ""), rows) if rows else "")
    )


def _worth(its: Diagnosis) -> str:
    rows = [
        (
            text(cause.effect),
            figure_of(cause.held_out_nats),
            figure_of(cause.drop_one_nats),
            percent(cause.shapley),
        )
        for cause in its.causes
        if any(x is not None for x in (cause.held_out_nats, cause.drop_one_nats, cause.shapley))
    ]
    heads = ("effect", "gain held out [nats]", "loss without it [nats]", "Shapley share")
    return table(heads, rows) if rows else ""


def _unknown(its: Diagnosis) -> str:
    if its.unknown is None:
        return ""
    rest = its.unknown
    stages = [(text(stage), figure_of(share)) for stage, share in rest.stages.items()]
    pieces = [
        "<h3>What is known of the unexplained part</h3>",
        paragraph(text(rest.text)),
        table(("stage", "probability"), stages) if stages else "",
        paragraph(f"Where: {listed(rest.places)}." if rest.places else "Where: not resolved."),
    ]
    if rest.nearest:
        gain = f", {figure_of(rest.nearest_nats)} nats" if rest.nearest_nats is not None else ""
        pieces.append(paragraph(f"Nearest in the library: {text(rest.nearest)}{gain}."))
    if rest.explained is not None:
        pieces.append(
            paragraph(f"The library explains {percent(rest.explained)} of what any model could.")
        )
    return "".join(pieces)


def experiment(its: Diagnosis) -> str:
    """Write the card of the recommended experiment."""
    if its.experiment is None:
        why = "" if its.state == "ambiguous" else "nothing has to be told apart"
        return section("experiment", "Recommended experiment", missing("An experiment", why))
    plan = its.experiment
    rows = [(name, value) for name, value in _plan(plan) if value]
    return section(
        "experiment",
        "Recommended experiment",
        f'<div class="card" style="--badge: #00724f"><span class="badge">{text(plan.kind)}</span>'
        f'<p class="said">{text(plan.text)}</p></div>',
        table(("", ""), rows),
    )


def _plan(plan: Experiment) -> Iterator[tuple[str, str]]:
    yield "tells apart", listed(plan.splits)
    yield "devices", listed(plan.devices)
    yield "singular modes, from 0", ", ".join(str(mode) for mode in plan.modes)
    for name, value, unit in (
        ("largest change of a setpoint", plan.amplitude, "A"),
        ("cost: orbit it makes, rms", plan.orbit_cost_um, "µm"),
        ("beam time", plan.minutes, "min"),
        ("expected separation", plan.separation_nats, "nats"),
    ):
        yield name, f"{figure_of(value)} {unit}" if value is not None else "not resolved"
    yield "limits", text(plan.limits)
    command = f"<code>orbitfb run --ioc sim --excite {text(plan.file)}</code>"
    yield "try it on the simulated ring first", command if plan.file else ""


def provenance(its: Diagnosis) -> str:
    """Write what is needed to get the same answer again."""
    origin = its.provenance
    rows = [
        (name, value)
        for name, value in (
            ("record", text(origin.source)),
            ("its SHA-256", f"<code>{text(origin.data_sha256)}</code>"),
            ("reference record", text(origin.reference_source)),
            ("its SHA-256", f"<code>{text(origin.reference_sha256)}</code>"),
            ("later record", text(origin.holdout_source)),
            ("its SHA-256", f"<code>{text(origin.holdout_sha256)}</code>"),
            ("readings", f"{origin.ticks} × {origin.bpms} BPMs, {origin.correctors} correctors"),
            ("planes", text(origin.planes)),
            ("period", f"{figure_of(origin.period_s)} s"),
            ("reading noise", f"{figure_of(origin.reading_noise_um)} µm"),
            ("drift per tick", f"{figure_of(origin.drift_um_per_tick)} µm"),
            ("gauge of the gains", text(origin.gauge)),
            ("model's SHA-256", f"<code>{text(origin.model_sha256)}</code>"),
            ("library's SHA-256", f"<code>{text(origin.library_sha256)}</code>"),
            ("seed", str(origin.seed)),
            ("versions", text(", ".join(f"{k} {v}" for k, v in origin.versions.items()))),
            ("thresholds", text(_thresholds(its))),
            ("computed in", "" if origin.seconds is None else f"{origin.seconds:.3g} s"),
        )
        if value and value not in ("<code></code>", "not resolved s", "not resolved µm")
    ]
    return section("provenance", "Provenance", table(("", ""), rows))


def _thresholds(its: Diagnosis) -> str:
    return ", ".join(f"{k} {figure_of(v)}" for k, v in its.provenance.thresholds.items())
