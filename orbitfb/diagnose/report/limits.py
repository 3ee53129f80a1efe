"""Sections of the page about limits: what the record cannot tell, what is left, where from."""

from collections.abc import Iterator

from orbitfb.diagnose.report import limit_pictures
from orbitfb.diagnose.report.opening import micrometres
from orbitfb.diagnose.result.blocks import Audit
from orbitfb.diagnose.result.diagnosis import Diagnosis
from orbitfb.diagnose.result.quantities import quantity
from orbitfb.html.page import (
    folded,
    listed,
    missing,
    paragraph,
    section,
    sentence,
    table,
    text,
)


def limits(its: Diagnosis) -> str:
    """Show what this record cannot tell."""
    pieces: list[str] = []
    if its.identifiability is not None:
        alike = its.identifiability
        names = alike.effects
        rows = [
            (
                text(name),
                *("" if one is None else f"{one:.2f}".replace("-0.00", "0.00") for one in row),
            )
            for name, row in zip(names, alike.cosine, strict=True)
        ]
        pieces.append(
            paragraph(
                "How similar the changes are that the best effects make to this record (cosine). "
                "Two effects at ±1 cannot be told apart.",
                "note",
            )
        )
        pieces.append(table(("", *map(text, names)), rows))
        pieces += [paragraph(text(line)) for line in alike.degenerate]
    if its.detectable:
        rows = [
            (
                text(one.effect),
                text(one.parameter),
                "none" if one.size is None else text(quantity(one.size, one.unit)),
                "none" if one.best is None else text(quantity(one.best, one.unit)),
            )
            for one in its.detectable
        ]
        heads = ("effect", "parameter", "at half of the places", "at the best place")
        pieces.append(
            folded(
                "smallest size of each effect that this record would have shown (5 standard "
                "deviations)",
                table(heads, rows),
            )
        )
    if its.not_tested:
        rows = [(text(one.effect), sentence(one.reason)) for one in its.not_tested]
        pieces += ["<h3>Not tested</h3>", table(("effect", "why"), rows)]
    if not pieces:
        pieces.append(missing("What the record cannot tell"))
    return section("limits", "What this record can and cannot tell", *pieces)


def _cosine(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}".replace("-0.00", "0.00")


def audit(its: Diagnosis) -> str:
    """Show what is left."""
    title = "What is left, against noise"
    if its.audit is None:
        return section("audit", title, missing("The audit of what is left"))
    said = (
        "With all causes in the model, the errors of its predictions should be white noise. For "
        "white noise, 99 of 100 records stay within each limit."
    )
    return section("audit", title, paragraph(said, "note"), *_audit(its.audit))


def _audit(its: Audit) -> Iterator[str]:
    rows = [
        (
            text(test.name) + (f" ({listed(test.places)})" if test.places else ""),
            f"{test.value or 0.0:.3g}",
            f"{test.limit or 0.0:.3g}",
            '<span class="flag">beyond</span>' if test.flagged else "within",
            text(test.note),
        )
        for test in its.tests
    ]
    if rows:
        yield table(("test", "value", "limit", "", ""), rows)
    yield limit_pictures.audit(its)
    loud = [(text(name), f"{value or 0.0:.2f}") for name, value in its.worst_channels.items()]
    late = [(text(name), f"{value or 0.0:.2f}") for name, value in its.worst_ticks.items()]
    content = table(("BPM", "mean square, 1 expected"), loud) if loud else ""
    content += table(("row", "mean square, 1 expected"), late) if late else ""
    if content:
        yield folded("loudest BPMs and rows", content)


def provenance(its: Diagnosis) -> str:
    """Write what is needed to get the same answer again."""
    origin = its.provenance
    period = origin.period_s
    rows = [
        (name, value)
        for name, value in (
            ("record", text(origin.source)),
            ("its SHA-256", _code(origin.data_sha256)),
            ("reference record", text(origin.reference_source)),
            ("its SHA-256", _code(origin.reference_sha256)),
            ("later record", text(origin.holdout_source)),
            ("its SHA-256", _code(origin.holdout_sha256)),
            ("readings", f"{origin.ticks} × {origin.bpms} BPMs, {origin.correctors} correctors"),
            ("planes", text(origin.planes)),
            ("from row to row", "" if period is None else quantity(period, "s")),
            ("reading noise", _length(origin.reading_noise_um)),
            ("drift from row to row", _length(origin.drift_um_per_tick)),
            ("gauge of the gains", text(origin.gauge)),
            ("model's SHA-256", _code(origin.model_sha256)),
            ("library's SHA-256", _code(origin.library_sha256)),
            ("seed", str(origin.seed)),
            ("versions", text(", ".join(f"{k} {v}" for k, v in origin.versions.items()))),
            ("thresholds", text(", ".join(f"{k} {v}" for k, v in origin.thresholds.items()))),
            ("computed in", "" if origin.seconds is None else f"{origin.seconds:.3g} s"),
        )
        if value
    ]
    return section("provenance", "Where this comes from", table(("", ""), rows))


def _code(digest: str) -> str:
    return f"<code>{text(digest)}</code>" if digest else ""


def _length(value: float | None) -> str:
    return "" if value is None else micrometres(value)
