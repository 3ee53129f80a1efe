"""Pictures of the causes: tournament, score over the ring, fingerprints, waterfall."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from orbitfb.diagnose.answer_blocks import (
    Fingerprint,
    Geometry,
    ScoreMap,
    ScoreRow,
    Tournament,
    TournamentRow,
    WaterfallStep,
)
from orbitfb.diagnose.report.draw import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    RED,
    STAGES,
    known,
    picture,
    rounded,
    sectors,
    shorten,
    values,
    whiskers,
)

_MOST = 30
_LINEAR = 10.0
"""Gain beyond which the axis of the tournament is logarithmic [nats]."""


def tournament(its: Tournament) -> str:
    """Draw the held-out gain of the kinds of effects, the best above; classes in brackets."""
    rows = _grouped([row for row in its.rows if row.nats is not None])[:_MOST]

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        told = values([row.nats for row in rows])
        # What is worse by orders of magnitude would leave the others no room.
        least = -max(_LINEAR, float(np.nanmax(told, initial=0.0)))
        gains = np.maximum(told, least)
        places = np.arange(len(rows))
        colours = [RED if row.accepted else BLUE for row in rows]
        axes.barh(places, gains, color=colours, height=0.7)
        for place in np.flatnonzero(told < least):
            axes.annotate(f" {told[place]:.2g} nats", (0.0, place), va="center", fontsize=7)
        shown = [row if row.nats is not None and row.nats >= least else None for row in rows]
        lows = [None if row is None else row.low for row in shown]
        highs = [None if row is None else row.high for row in shown]
        bars = whiskers(gains.tolist(), lows, highs)
        axes.errorbar(gains, places, xerr=bars, fmt="none", ecolor=BLACK, elinewidth=0.8)
        axes.set_yticks(places, [_label(row) for row in rows], fontsize=8)
        axes.set_ylim(len(rows) - 0.4, -0.6)
        wide = float(np.nanmax(np.abs(gains))) > _LINEAR
        if wide:
            axes.set_xscale("symlog", linthresh=_LINEAR)
        axes.axvline(0.0, color=BLACK, lw=0.6)
        _lines(axes, its)
        _brackets(axes, rows)
        scale = f"; linear below {_LINEAR:g}, logarithmic above" if wide else ""
        axes.set_xlabel(f"gain on held-out ticks [nats]{scale}")
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0))

    return picture(
        "Every kind of effect at its best places, on ticks not used to fit it. Red: accepted; "
        "brackets: classes that this record cannot tell apart.",
        (9.5, 0.24 * len(rows) + 1.2),
        paint,
    )


def _label(row: TournamentRow) -> str:
    return shorten(row.effect, 26) + (f" · {shorten(row.places, 22)}" if row.places else "")


def _grouped(rows: Sequence[TournamentRow]) -> list[TournamentRow]:
    """Sort by gain, the members of a class behind their best."""
    best: dict[str, float] = {}
    for row in rows:
        for member in row.members or (row.effect,):
            best[member] = max(best.get(member, -np.inf), row.nats or 0.0)

    def key(row: TournamentRow) -> tuple[float, tuple[str, ...], float]:
        members = row.members or (row.effect,)
        return (-max(best[member] for member in members), tuple(sorted(members)), -(row.nats or 0))

    return sorted(rows, key=key)


def _lines(axes: Axes, its: Tournament) -> None:
    if its.ceiling_nats is not None:
        axes.axvline(
            its.ceiling_nats, color=ORANGE, ls="-.", lw=1, label="what any model could gain"
        )


def _brackets(axes: Axes, rows: Sequence[TournamentRow]) -> None:
    start = 0
    while start < len(rows):
        members = set(rows[start].members)
        stop = start + 1
        while stop < len(rows) and len(members) > 1 and set(rows[stop].members) == members:
            stop += 1
        if stop - start > 1:
            right = axes.get_yaxis_transform()
            axes.plot(
                [0.985, 1.0, 1.0, 0.985],
                [start - 0.3, start - 0.3, stop - 0.7, stop - 0.7],
                color=BLACK,
                lw=1,
                transform=right,
                clip_on=False,
            )
        start = stop


def scores(its: ScoreMap, ring: Geometry | None) -> str:
    """Draw the gain of every stage over the ring, with the places named."""
    drawn = [row for row in its.rows if known(row.gain)]
    if not drawn:
        return ""

    def paint(figure: Figure) -> None:
        all_axes = figure.subplots(len(drawn), squeeze=False)[:, 0]
        for index, (axes, row) in enumerate(zip(all_axes, drawn, strict=True)):
            _score(axes, row)
            if its.threshold_nats is not None:
                axes.axhline(its.threshold_nats, color=GREY, ls="--", lw=0.8)
                axes.set_ylim(None, max(axes.get_ylim()[1], 1.3 * its.threshold_nats))
            sectors(axes, ring, label=index == 0)

    return picture(
        "Gain of log-likelihood [nats] by an effect at each place, on the nominal model. "
        "Marks: the places named; shaded: places that cannot be excluded; dashed: what chance "
        "reaches at the best place once in 100 records.",
        (10.0, 1.7 * len(drawn) + 0.4),
        paint,
    )


def _score(axes: Axes, row: ScoreRow) -> None:
    gains = values(row.gain)
    known_places = len(row.s_m) == len(gains) and all(s is not None for s in row.s_m)
    places = values(row.s_m) if known_places else np.arange(len(gains), dtype=float)
    axes.set_xlabel("s [m]" if known_places else "in the order of the record")
    colour = STAGES.get(row.stage, GREY)
    possible = [i for i in (*row.within, *row.fitted) if i < len(gains)]
    if possible:
        pitch = float(np.median(np.abs(np.diff(places)))) if len(places) > 1 else 1.0
        for i in possible:
            axes.axvspan(places[i] - pitch / 2, places[i] + pitch / 2, color=colour, alpha=0.13)
    axes.vlines(places, 0.0, gains, color=colour, lw=1)
    fitted = [i for i in row.fitted if i < len(gains)]
    if fitted:
        axes.plot(places[fitted], gains[fitted], "v", color=colour, ms=6, mec=BLACK, mew=0.6)
    axes.set_ylim(min(0.0, float(np.nanmin(gains))), None)
    axes.margins(y=0.15)
    axes.set_title(f"{shorten(row.stage)}: {shorten(row.effect, 40)}", pad=10)
    axes.set_ylabel("nats")


def fingerprint(its: Fingerprint) -> str:
    """Draw the slice of the record that shows an effect best."""

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        x = values(its.x)
        error = values(its.error) if len(its.error) == len(x) else None
        axes.errorbar(
            x, values(its.measured), error, fmt="o", ms=4, color=BLACK, label="record", zorder=3
        )
        if its.nominal:
            axes.plot(x, values(its.nominal), "--", color=BLUE, label="nominal model")
        if its.refit:
            axes.plot(x, values(its.refit), color=RED, label="with the cause")
        axes.set_xlabel(shorten(its.x_label, 60))
        axes.set_ylabel(shorten(its.y_label, 48))
        axes.legend()

    return picture(its.title, (7.5, 3.0), paint)


def waterfall(steps: Sequence[WaterfallStep]) -> str:
    """Draw what is left of the gap, effect by effect, beside each other for fit and held-out."""

    def paint(figure: Figure) -> None:
        columns = {
            "data of the fit": [step.fit for step in steps],
            "held-out data": [step.held_out for step in steps],
        }
        drawn = {title: left for title, left in columns.items() if known(left)}
        all_axes = figure.subplots(1, 2, sharey=True)
        for axes, title in zip(all_axes, columns, strict=True):
            axes.set_title(title)
            if title in drawn:
                _falls(axes, [step.label for step in steps], drawn[title])
            else:
                axes.set_title(f"{title}: not resolved")
                axes.set_axis_off()
        all_axes[0].set_ylabel("gap left [nats/tick]")

    return picture(
        "The gap left as one cause after the other joins the model; zero is the floor. Light: what "
        "each takes away.",
        (9.5, 2.9),
        paint,
    )


def _falls(axes: Axes, labels: Sequence[str], left: Sequence[float | None]) -> None:
    heights = values(left)
    places = np.arange(len(labels))
    axes.bar(places, heights, color=BLUE, width=0.65)
    for place in places[1:]:
        before, after = heights[place - 1], heights[place]
        if np.isfinite(before) and np.isfinite(after):
            colour = GREEN if after <= before else RED
            axes.bar(place, before - after, 0.65, bottom=after, color=colour, alpha=0.25)
            axes.plot([place - 0.67, place + 0.33], [before, before], color=GREY, lw=0.7)
    for place, height in zip(places, heights, strict=True):
        said = rounded(height, heights) if np.isfinite(height) else "not resolved"
        axes.annotate(
            said,
            (float(place), height if np.isfinite(height) else 0.0),
            xytext=(0, 2),
            textcoords="offset points",
            ha="center",
            va="bottom",
            fontsize=8,
        )
    axes.set_xticks(places, [shorten(label, 26) for label in labels], rotation=20, ha="right")
    axes.margins(y=0.12)
    axes.axhline(0.0, color=BLACK, lw=0.6)
