"""Pictures of evidence: effects, places, steps of the readings, answers by age."""

from collections.abc import Sequence

import numpy as np

from orbitfb.diagnose.result.blocks import (
    Fingerprint,
    LagProfile,
    ScoreMap,
    ScoreRow,
    TournamentRow,
    WaterfallStep,
)
from orbitfb.diagnose.result.parts import Gap
from orbitfb.html.axis import Axis, known, values
from orbitfb.html.svg import BLUE, GREY, INK, RED, STAGES, Panel, picture, shorten

_ROW = 19
"""Height of a row of bars that lie."""


def tournament(rows: Sequence[TournamentRow], free: float | None) -> str:
    """Draw the evidence of effects, the best above."""
    gains = values([row.nats for row in rows])
    panel = _lying("evidence [nats]", gains, [_label(row) for row in rows], 250)
    colours = [RED if row.accepted else BLUE for row in rows]
    panel.lying(gains, colours, [f"{gain:.0f}" for gain in gains])
    if free is not None and 0.0 < free < panel.x.high:
        panel.moment(free, GREY, "an unknown law")
    said = "Evidence for each effect at its best places. Red: named as a cause."
    return picture(said, [panel])


def _lying(label: str, lengths: np.ndarray, words: Sequence[str], left: int) -> Panel:
    longest = float(np.nanmax(lengths, initial=0.0)) or 1.0
    ticks = [(float(place), word) for place, word in enumerate(words)]
    y = Axis("", len(words) - 0.4, -0.6, ticks=ticks)
    return Panel(Axis(label, 0.0, 1.12 * longest), y, height=_ROW * len(words) + 6, left=left)


def _label(row: TournamentRow) -> str:
    return shorten(row.effect, 24) + (f" · {shorten(row.places, 16)}" if row.places else "")


def waterfall(steps: Sequence[WaterfallStep], gap: Gap | None) -> str:
    """Draw what is left of the gap as one cause after the other joins the model."""
    left = values([step.left_nats for step in steps])
    labels = [shorten(step.label, 36) for step in steps]
    panel = _lying("rest of the gap [nats a row]", left, labels, 210)
    colours = [INK, *[BLUE] * (len(steps) - 1)]
    largest = float(np.nanmax(left, initial=0.0))
    words = ["0" if abs(value) < 1e-4 * largest else f"{value:.3g}" for value in left]
    panel.lying(left, colours, words)
    said = "The rest of the gap as one cause after the other joins the model."
    if gap is not None and (gap.by_stage.get("unexplained") or 0.0) > 0.0:
        said += " No effect explains the last bar."
    return picture(said, [panel])


def scores(its: ScoreMap) -> str:
    """Draw what an effect of every stage explains over the ring, with the places named."""
    drawn = [row for row in its.rows if known(row.gain)]
    if not drawn:
        return ""
    said = (
        "Evidence for an effect at every place, before any cause is in the model. Red: the named "
        "places. Dashed: chance alone passes this at the best place of one record in 100."
    )
    return picture(said, *([_score(row, its.threshold_nats)] for row in drawn))


def _score(row: ScoreRow, threshold: float | None) -> Panel:
    gains = values(row.gain)
    placed = len(row.s_m) == len(gains) and all(s is not None for s in row.s_m)
    places = values(row.s_m) if placed else np.arange(len(gains), dtype=float)
    panel = Panel(
        Axis.over("s [m]" if placed else "in the order of the record", places),
        Axis.over("nats", np.maximum(gains, 0.0), [1.2 * (threshold or 0.0)], zero=True),
        height=90,
        title=f"{row.stage}: {shorten(row.effect, 40)}",
    )
    panel.stems(places, np.maximum(gains, 0.0), STAGES.get(row.stage, GREY))
    if row.fitted:
        marked = list(row.fitted)
        panel.dots(places[marked], np.maximum(gains[marked], 0.0), RED)
    if threshold is not None:
        panel.level(threshold)
    return panel


def fingerprint(its: Fingerprint) -> str:
    """Draw what the readings show against what the cause adds."""
    x, shown = values(its.x), values(its.measured)
    error = values(its.error) if len(its.error) == len(x) else np.zeros(len(x))
    panel = Panel(
        Axis.over(shorten(its.x_label, 70), x),
        Axis.over("step of the readings [µm]", shown, its.refit, its.nominal),
        height=170,
    )
    for label, heights, colour, dashed in (
        ("without the cause", its.nominal, BLUE, True),
        ("with the cause", its.refit, RED, False),
    ):
        if len(heights) == len(x):
            panel.line(x, heights, colour, label, dashed)
    panel.dots(x, shown, INK, "readings", (shown - error, shown + error))
    said = (
        f"{its.title}: {its.y_label}, against the {its.x_label}. If the law is right, the points "
        "lie on the red line."
    )
    return picture(said, [panel])


def lags(profile: LagProfile) -> str:
    """Draw the answer to changes of the setpoints by their age."""
    ages = np.array(profile.lags, dtype=float)
    ticks = [(age, f"{age:g}") for age in ages.tolist()]
    panel = Panel(
        Axis("rows since the change of the setpoints", -0.5, ages[-1] + 0.5, ticks=ticks),
        Axis.over("share of the change", profile.slope, profile.low, profile.high, [0.0]),
        height=130,
    )
    ends = (profile.low, profile.high) if profile.low and profile.high else None
    panel.level(0.0, dashed=False)
    panel.dots(ages, profile.slope, BLUE, "nominal model", ends)
    if profile.refit:
        panel.dots(ages + 0.14, profile.refit, RED, "with the causes")
    said = (
        "Response of the orbit to a change of all correctors, minus that of the model, against the "
        "age of the change. It is 0 if the model is right."
    )
    return picture(said, [panel])
