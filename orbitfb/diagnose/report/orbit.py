"""Sections of the page that speak of the orbit: how far it shrinks, predictions, loop, places."""

from orbitfb.diagnose.report import orbit_pictures
from orbitfb.diagnose.report.opening import micrometres
from orbitfb.diagnose.result.blocks import ClosedLoop
from orbitfb.diagnose.result.diagnosis import Diagnosis
from orbitfb.diagnose.result.parts import Shrink
from orbitfb.diagnose.result.quantities import percent
from orbitfb.html.axis import known
from orbitfb.html.page import missing, paragraph, section, table, text


def orbit(its: Diagnosis) -> str:
    """Show what the causes do to the orbit, and how much of that is gone with them."""
    title = "What it does to the orbit"
    if not its.causes:
        return section("orbit", title, missing("What causes do to the orbit", "no cause is named"))
    pieces = [
        _shrink(its.shrink)
        if its.shrink
        else missing("The shrink", "the cause is noise, which changes no prediction")
    ]
    if its.k_steps:
        pieces.append(orbit_pictures.k_steps(its.k_steps))
    if its.closed_loop is not None:
        pieces += _loop(its.closed_loop)
    return section("orbit", title, *pieces)


def _shrink(its: Shrink) -> str:
    on = text(its.on) or "the record"
    if not its.resolved:
        return paragraph(f"On {on} the gap is not larger than its uncertainty.")
    rows = [
        ("error of a prediction beyond noise and drift, nominal model", micrometres(its.before_um)),
        ("the same, with the causes in the model", micrometres(its.after_um)),
        ("removed by the causes, 90 % interval", percent(its.um, its.um_low, its.um_high)),
    ]
    return paragraph(f"Measured on {on}, {its.held_out_ticks} rows.") + table(("", ""), rows)


def _loop(loop: ClosedLoop) -> list[str]:
    pieces: list[str] = []
    if loop.without_um is not None:
        pieces.append(orbit_pictures.closed_loop(loop))
    if loop.note:
        pieces.append(paragraph(f"The loop without the causes: {text(loop.note)}.", "note"))
    if loop.radius_without is not None:
        mended = loop.radius_with
        told = "" if mended is None else f", with the causes {mended:.4f}"
        pieces.append(
            paragraph(
                f"Slowest decay of an orbit error in the loop, from row to row: nominal "
                f"{loop.radius_without:.4f}{told} (below 1: stable).",
                "note",
            )
        )
    return pieces


def where(its: Diagnosis) -> str:
    """Show where the gap lies."""
    title = "Where and when"
    gap = its.gap
    if gap is None or not (gap.um_by_bpm or gap.by_window):
        why = (
            "the cause is noise, which has no place in time" if its.causes else "no cause is named"
        )
        return section("gap", title, missing("Where the gap lies", why))
    onsets = [cause.onset_s for cause in its.causes if cause.onset_s is not None]
    return section(
        "gap",
        title,
        orbit_pictures.along_the_ring(gap, its.geometry) if known(tuple(gap.um_by_bpm.values()))
        else "",
        orbit_pictures.in_time(gap, onsets) if gap.by_window and gap.by_band else "",
        orbit_pictures.modes(gap.by_mode) if known(gap.by_mode) else "",
    )  # fmt: skip
