"""Sections of the page that show why: gap, tournament, places, predictions, limits, audit."""

from collections.abc import Sequence

from orbitfb.diagnose.answer import Diagnosis
from orbitfb.diagnose.answer_blocks import Audit, ClosedLoop, KStep
from orbitfb.diagnose.answer_parts import Gap, Shrink
from orbitfb.diagnose.report import cause_pictures, gap_pictures, loop_pictures, map_pictures
from orbitfb.diagnose.report.draw import known
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
from orbitfb.effects.random_kinds import LatentKind, NoiseKind
from orbitfb.effects.registry import all_effects

_CLASS_MOST = 6


def gap(its: Diagnosis) -> str:
    """Show where the gap lies."""
    if its.gap is None:
        return section("gap", "Where the gap lies", missing("The gap"))
    its_gap = its.gap
    onsets = [cause.onset_s for cause in its.causes if cause.onset_s is not None]
    source = f" Floor: {text(its_gap.floor_from)}." if its_gap.floor_from else ""
    return section(
        "gap",
        "Where the gap lies",
        paragraph(
            "The gap is what the record costs under the nominal model over what its noise alone "
            f"would cost, in nats per tick.{source}",
            "note",
        ),
        *_parts(its, onsets),
        gap_pictures.lags(its.lag_profile)
        if its.lag_profile and known(its.lag_profile.slope)
        else missing("By lag"),
        *[
            map_pictures.heat(one) if any(known(row) for row in one.values) else missing(one.title)
            for one in its.maps
            if any(any(row) for row in one.values) or not _nothing(its_gap)
        ],
    )


def _nothing(its: Gap) -> bool:
    """Whether every part of the gap is zero: the nominal model is the best explanation."""
    return its.nats_per_tick == 0.0 and not any(its.by_bpm.values())


def _parts(its: Diagnosis, onsets: Sequence[float]) -> list[str]:
    its_gap = its.gap
    if its_gap is None:
        return []
    if _nothing(its_gap):
        return [missing("The parts of the gap", "nothing explains the record better than noise")]
    return [
        gap_pictures.stages(its_gap.by_stage)
        if known(tuple(its_gap.by_stage.values()))
        else missing("By stage"),
        gap_pictures.devices(its_gap, its.geometry) or missing("By device"),
        gap_pictures.windows(its_gap.by_window, onsets)
        if its_gap.by_window
        else missing("By time window"),
        gap_pictures.bands(its_gap.by_band) if its_gap.by_band else missing("By frequency band"),
        gap_pictures.modes(its_gap.by_mode)
        if known(its_gap.by_mode)
        else missing("By singular mode"),
        gap_pictures.bins(its_gap.by_bin)
        if its_gap.by_bin
        else missing("By amplitude, direction and reversal"),
    ]


def tournament(its: Diagnosis) -> str:
    """Show the kinds of effects against each other."""
    title = "Which effect: the tournament"
    if its.tournament is None or not any(row.nats is not None for row in its.tournament.rows):
        return section("tournament", title, missing("The tournament"))
    ranked = sorted(its.tournament.rows, key=lambda row: -(row.nats or 0.0))
    rows = [
        (
            f"<b>{text(row.effect)}</b>" if row.accepted else text(row.effect),
            text(row.places),
            interval(row.nats, row.low, row.high),
            "not resolved" if row.probability is None else f"{min(row.probability, 0.999):.3g}",
            listed(row.members, _CLASS_MOST) if len(row.members) > 1 else "",
        )
        for row in ranked
    ]
    heads = ("effect", "best places", "held-out gain [nats]", "P of its class", "class")
    return section(
        "tournament", title, cause_pictures.tournament(its.tournament), table(heads, rows)
    )


def places(its: Diagnosis) -> str:
    """Show the score over the ring."""
    drawn = cause_pictures.scores(its.score_map, its.geometry) if its.score_map else ""
    title = "Where along the ring"
    return section("places", title, drawn or missing("The score map", "no effect with places"))


def fingerprints(its: Diagnosis) -> str:
    """Show the slices that show the effects best."""
    drawn = [cause_pictures.fingerprint(one) for one in its.fingerprints if known(one.measured)]
    reason = "no cause has a course in time to be shown" if its.causes else "no cause is named"
    return section("fingerprints", "Fingerprints", *(drawn or [missing("A fingerprint", reason)]))


def shrinking(its: Diagnosis) -> str:
    """Show how far the gap shrinks."""
    return section(
        "shrink",
        "How far the gap shrinks",
        _shrink(its.shrink) if its.shrink else missing("The shrink", _why_no_shrink(its)),
        cause_pictures.waterfall(its.waterfall)
        if its.waterfall
        else missing("The waterfall", "no cause is named"),
    )


def _why_no_shrink(its: Diagnosis) -> str:
    if not its.causes:
        return "no cause is named"
    return "no data are left for it, or no cause has a course in time"


def _shrink(its: Shrink) -> str:
    on = text(its.on) or "data used neither for fitting nor for selection"
    said = paragraph(f"On {on}, {its.held_out_ticks} ticks.")
    if not its.resolved:
        return said + paragraph(
            "Not resolved: there is no gap there that is larger than its own uncertainty."
        )

    def share(value: float | None, low: float | None, high: float | None) -> str:
        ends = "" if low is None or high is None else f" [{100 * low:.0f}, {100 * high:.0f}]"
        return percent(value) + ends

    rows = [
        (
            "nats",
            f"{figure_of(its.before_nats_per_tick)} → {figure_of(its.after_nats_per_tick)} "
            "nats/tick",
            share(its.nats, its.low, its.high),
            percent(its.competitor_nats),
            "",
        ),
        (
            "one step",
            f"{figure_of(its.before_um)} → {figure_of(its.after_um)} µm",
            share(its.um, its.um_low, its.um_high),
            percent(its.competitor_um),
            _net(its),
        ),
    ]
    heads = ("measure", "gap", "gone with the causes", "with a refitted R", "with the forward net")
    return said + table(heads, rows)


def _net(its: Shrink) -> str:
    if its.net_um is None:
        return text(its.net_note)
    return percent(its.net_um) + (f" ({text(its.net_note)})" if its.net_note else "")


def predictions(its: Diagnosis) -> str:
    """Show predictions over k steps and the closed loop."""
    pieces = [missing("The prediction over k steps", _why_no_shrink(its))]
    if any(step.nominal_um is not None for step in its.k_steps):
        rows = [_step(step) for step in its.k_steps]
        heads = (
            "ticks ahead",
            "nominal [µm]",
            "with the causes [µm]",
            "refitted R [µm]",
            "forward net [µm]",
        )
        pieces = [loop_pictures.k_steps(its.k_steps), table(heads, rows)]
    if its.closed_loop is None:
        pieces.append(missing("The closed loop", "no cause is named"))
    else:
        loop = its.closed_loop
        pieces += [
            loop_pictures.closed_loop(loop),
            paragraph(_stability(loop)),
            paragraph(text(loop.note), "note"),
        ]
    return section("predictions", "Predictions and the closed loop", *pieces)


def _stability(loop: ClosedLoop) -> str:
    if loop.radius_without is None:
        return ""
    mended = loop.radius_with
    with_causes = "" if mended is None else f", {mended:.5f} with the causes"
    return (
        f"Spectral radius of the loop: {loop.radius_without:.5f} nominal{with_causes} (stable "
        "below 1; near 1 it is that of the modes that the law hardly corrects)."
    )


def _step(step: KStep) -> tuple[str, str, str, str, str]:
    nominal = interval(step.nominal_um, step.nominal_low, step.nominal_high)
    return (
        str(step.k),
        nominal if step.resolved else f"{nominal} (not resolved)",
        interval(step.effect_um, step.effect_low, step.effect_high),
        figure_of(step.competitor_um),
        "" if step.net_um is None else figure_of(step.net_um),
    )


def limits(its: Diagnosis) -> str:
    """Show what this record cannot tell."""
    pieces: list[str] = []
    if its.identifiability is None:
        pieces.append(missing("How alike the effects are"))
    else:
        alike = its.identifiability
        if any(known(row) for row in alike.cosine):
            pieces.append(loop_pictures.cosines(alike))
        pieces += [paragraph(text(line)) for line in alike.degenerate]
    if its.detectable:
        rows = [
            (text(d.effect), text(d.parameter), _size(d.size, d.unit), _size(d.best, d.unit))
            for d in its.detectable
        ]
        heads = ("effect", "parameter", "5σ size, median over places", "at the best place")
        pieces += ["<h3>What this record would have shown</h3>", table(heads, rows)]
    else:
        pieces.append(missing("Detectable sizes"))
    if its.not_tested:
        rows = [(text(one.effect), sentence(one.reason)) for one in its.not_tested]
        pieces += ["<h3>Not tested</h3>", table(("effect", "reason"), rows)]
    return section("limits", "What this record can and cannot tell", *pieces)


def _size(value: float | None, unit: str) -> str:
    return interval(value, None, None, unit)


def audit(its: Diagnosis) -> str:
    """Show what is left."""
    title = "Residual audit"
    if its.audit is None:
        return section("audit", title, missing("The audit of what is left"))
    kinds = all_effects()
    noisy = [
        one.effect
        for one in its.causes
        if isinstance(kinds.get(one.effect), NoiseKind | LatentKind)
    ]
    beside = (
        f"Noise has no course that could be taken out: what {' and '.join(noisy)} does is still in "
        "what these tests look at, and they may show it."
    )
    pieces = ([paragraph(text(beside), "note")] if noisy else []) + _audit(its.audit)
    return section("audit", title, *pieces)


def _audit(its: Audit) -> list[str]:
    pieces: list[str] = []
    if its.tests:
        rows = [
            (
                text(test.name),
                figure_of(test.value),
                figure_of(test.limit),
                '<span class="flag">flagged</span>' if test.flagged else "passed",
                figure_of(test.nats),
                sentence(test.note) if test.note else "",
            )
            for test in its.tests
        ]
        pieces.append(table(("test", "value", "limit", "", "worth [nats]", ""), rows))
    pieces.append(loop_pictures.audit(its))
    for title, worst in (
        ("worst channels", its.worst_channels),
        ("worst rows of the record", its.worst_ticks),
    ):
        if worst:
            rows = [(text(name), figure_of(value)) for name, value in worst.items()]
            pieces.append(table((title, "mean square, 1 expected"), rows))
    return pieces + [paragraph(text(line)) for line in its.sensitivity]
