"""The report of a measured response: one self-contained page."""

from collections.abc import Iterator, Sequence

from orbitfb.html.page import STYLE, figure_of, paragraph, section, table, text
from orbitfb.loco.output.pictures import along_ring, residuals, triple
from orbitfb.loco.run import Result
from orbitfb.loco.schema import ResponseDiagnosis

_MOST_ROWS = 40


def page(answer: ResponseDiagnosis, result: Result) -> str:
    """Write the page."""
    body = "\n".join(_sections(answer, result))
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{text(answer.source)}</title><style>{STYLE}</style></head><body>\n"
        f"<h1>Measured response {text(answer.source)}</h1>\n"
        f'<div class="card"><span class="badge">{text(answer.state)}</span>'
        f'<p class="said">{text(answer.headline)}</p></div>\n{body}\n</body></html>\n'
    )


def _sections(answer: ResponseDiagnosis, result: Result) -> Iterator[str]:
    yield section(
        "named",
        "Devices that stand out of the healthy spread",
        _findings(answer),
        paragraph(text(answer.gauge), "note"),
        *(paragraph(text(its.text)) for its in answer.growth),
        *(paragraph(text(note), "note") for note in answer.notes),
    )
    yield section(
        "residuals",
        "How far the difference shrinks",
        table(
            ("block", "as it is", "one scale", "gains", "fit", "noise", "χ²/value before",
             "after", "outliers"),
            (
                (
                    f"{its.read} by {its.driven}",
                    *(_percent(v) for v in (its.raw, its.scale, its.gains, its.optics, its.noise)),
                    figure_of(its.chi2_before), figure_of(its.chi2_after), str(its.outliers),
                )
                for its in answer.blocks
            ),
        ),
        paragraph(
            "Relative residuals ‖M − model‖/‖M‖. χ² is per measured value, against the given noise "
            "where it is known, else against what the fit leaves."
        ),
        *(residuals(result, plane) for plane in result.mended.planes),
    )  # fmt: skip
    yield section(
        "matrices",
        "Measured, fitted, difference",
        *(triple(result, plane) for plane in result.mended.planes),
    )
    yield section(
        "ring",
        "Gains, calibrations and gradients along the ring",
        table(
            ("plane", "tune of the table", "fitted", "β-beat rms", "scale of the correctors"),
            (
                (
                    its.plane, figure_of(its.tune_table, 7), figure_of(its.tune_fit, 7),
                    _percent(its.beta_beat_rms), figure_of(its.scale, 4),
                )
                for its in answer.optics
            ),
        ),
        along_ring(answer),
    )  # fmt: skip
    if answer.outliers:
        yield section(
            "outliers",
            "Elements far from the fit, which do not count in it",
            table(
                ("BPM", "corrector", "residual [m/rad]", "σ"),
                (
                    (text(its.bpm), text(its.corrector), figure_of(its.residual_m_per_rad),
                     figure_of(its.sigmas))
                    for its in answer.outliers[:_MOST_ROWS]
                ),
            ),
            _more(answer.outliers),
        )  # fmt: skip


def _findings(answer: ResponseDiagnosis) -> str:
    if not answer.findings:
        return paragraph("None.")
    rows = (
        (
            text(its.kind), text(", ".join(its.places)), text(its.text),
            f"{figure_of(its.value)} ± {figure_of(its.sigma, 2)} {text(its.unit)}",
            figure_of(its.z), figure_of(its.probability), "yes" if its.named else "nearly",
        )
        for its in answer.findings[:_MOST_ROWS]
    )  # fmt: skip
    heads = ("kind", "where", "what", "size", "σ of the healthy spread", "P", "stands out")
    return table(heads, rows) + _more(answer.findings)


def _more(items: Sequence[object]) -> str:
    left = len(items) - _MOST_ROWS
    return paragraph(f"{left} more are in the tables beside this page.") if left > 0 else ""


def _percent(share: float | None) -> str:
    return "" if share is None else f"{100 * share:.3g} %"
