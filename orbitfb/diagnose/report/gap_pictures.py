"""Pictures of the gap: by stage, device, mode, band, window and bin."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from orbitfb.diagnose.answer_blocks import Geometry, LagProfile
from orbitfb.diagnose.answer_parts import Binning, Gap, GapPiece
from orbitfb.diagnose.report.draw import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    NOT_RESOLVED,
    RED,
    STAGES,
    along,
    known,
    picture,
    rounded,
    sectors,
    shorten,
    values,
    whiskers,
)

_NATS = "gap [nats/tick]"
_LONG = 10
"""Signs of a label beyond which labels below bars would touch."""
_DECADES = 20.0
"""Ratio of the edges beyond which an axis is logarithmic."""


def stages(by_stage: Mapping[str, float | None]) -> str:
    """Draw the parts of the gap by stage."""

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        names = list(by_stage)
        heights = values(list(by_stage.values()))
        axes.set_yticks(range(len(names)), [shorten(name) for name in names])
        axes.barh(range(len(names)), heights, color=[STAGES.get(name, GREY) for name in names])
        for index, height in enumerate(heights):
            said = "not resolved" if np.isnan(height) else rounded(height, heights)
            axes.annotate(
                said,
                (0.0 if np.isnan(height) else max(height, 0.0), index),
                xytext=(4, 0),
                textcoords="offset points",
                va="center",
                fontsize=8,
            )
        axes.invert_yaxis()
        axes.margins(x=0.12)
        axes.axvline(0.0, color=BLACK, lw=0.6)
        axes.set_xlabel(_NATS)

    return picture("The gap by stage; the parts add up.", (7.5, 0.4 * len(by_stage) + 0.8), paint)


def devices(gap: Gap, ring: Geometry | None) -> str:
    """Draw the gap by BPM and the score by corrector, along the ring where it is known."""
    rows = [
        ("BPMs", gap.by_bpm, ring.bpms if ring else None, _NATS, BLUE),
        ("BPMs, one-step excess", gap.um_by_bpm, ring.bpms if ring else None, "rms [µm]", BLUE),
        (
            "correctors (score, does not add up)",
            gap.by_corrector,
            ring.correctors if ring else None,
            "score [nats/tick]",
            RED,
        ),
    ]
    drawn = [row for row in rows if known(tuple(row[1].values()))]

    def paint(figure: Figure) -> None:
        all_axes = figure.subplots(len(drawn), squeeze=False)[:, 0]
        for index, (axes, (title, parts, where, label, colour)) in enumerate(
            zip(all_axes, drawn, strict=True)
        ):
            _stems(axes, parts, where, colour)
            axes.set_ylabel(label)
            axes.set_title(title, pad=12 if index == 0 else 6)
            sectors(axes, ring, label=index == 0)

    if not drawn:
        return ""
    return picture(
        "By device. What is not resolved has no mark.", (10.0, 1.9 * len(drawn) + 0.4), paint
    )


def _stems(
    axes: Axes,
    parts: Mapping[str, float | None],
    where: Mapping[str, float | None] | None,
    colour: str,
) -> None:
    names, heights = list(parts), values(list(parts.values()))
    places = along(axes, names, dict(where) if where else None)
    vertical = np.array([name.endswith(" (y)") for name in names])
    for chosen, its_colour, label in ((~vertical, colour, "x"), (vertical, GREEN, "y")):
        if chosen.any():
            axes.vlines(places[chosen], 0.0, heights[chosen], color=its_colour, lw=1.2)
            axes.plot(places[chosen], heights[chosen], "o", ms=2.2, color=its_colour, label=label)
    if vertical.any():
        axes.legend(loc="upper right", ncols=2)
    axes.axhline(0.0, color=BLACK, lw=0.6)


def modes(by_mode: Sequence[float | None]) -> str:
    """Draw the gap by singular mode and its sum from the strongest mode on."""

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        heights = values(by_mode)
        order = np.arange(1, len(heights) + 1)
        axes.bar(order, heights, width=1.0, color=BLUE)
        axes.set_xlabel("singular mode, strongest first")
        axes.set_ylabel(_NATS)
        axes.axhline(0.0, color=BLACK, lw=0.6)
        total = axes.twinx()
        total.plot(order, np.nancumsum(heights), color=BLACK, lw=1)
        total.set_ylim(*_with_zero(total))
        axes.set_ylim(*_with_zero(axes))
        total.set_ylabel("sum up to the mode")
        total.spines["right"].set_visible(True)

    return picture("The gap by singular mode; the line is the running sum.", (7.5, 2.4), paint)


def _with_zero(axes: Axes) -> tuple[float, float]:
    low, high = axes.get_ylim()
    return min(low, 0.0), max(high, 0.0)


def bands(pieces: Sequence[GapPiece]) -> str:
    """Draw the gap by frequency band."""
    return picture(
        "The gap by frequency band; the slowest has all below it. Hatched: not resolved at 99.5 %; "
        "bars: 90 %.",
        (7.5, 2.4),
        lambda figure: _pieces(figure.subplots(), pieces, "frequency [Hz]"),
    )


def windows(pieces: Sequence[GapPiece], onsets: Sequence[float]) -> str:
    """Draw the gap over time with the onsets of the causes."""

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        _pieces(axes, pieces, "time since the first reading [s]")
        for onset in onsets:
            axes.axvline(onset, color=RED, lw=1, ls="--", label="onset of a cause")
        if onsets:
            axes.legend(loc="upper left")

    said = "The gap by time window. Hatched: not resolved at 99.5 %; bars: 90 %."
    return picture(said, (10.0, 2.2), paint)


def _pieces(axes: Axes, pieces: Sequence[GapPiece], label: str) -> None:
    """Draw bars at their edges where all have edges and these do not differ in kind."""
    starts, stops = [p.start for p in pieces], [p.stop for p in pieces]
    edged = all(edge is not None for edge in (*starts, *stops))
    low, high = values(starts), values(stops)
    if edged and low.min() == 0.0 < high.min() and high.max() / high.min() > _DECADES:
        low = np.maximum(low, high.min() / 2.0)  # octaves, the first of which has all below it
    places = low if edged else np.arange(len(pieces), dtype=float) - 0.4
    widths = (high - low) if edged else np.full(len(pieces), 0.8)
    logarithmic = edged and low.min() > 0 and high.max() / low.min() > _DECADES
    for piece, place, width in zip(pieces, places, widths, strict=True):
        if piece.nats_per_tick is None:
            axes.axvspan(place, place + width, ymax=0.06, **NOT_RESOLVED)
            continue
        look: dict[str, Any] = (
            {"facecolor": BLUE, "edgecolor": "white", "linewidth": 0.6}
            if piece.resolved
            else NOT_RESOLVED
        )
        axes.bar(place, piece.nats_per_tick, width, align="edge", **look)
    if logarithmic:
        axes.set_xscale("log")
        centres = np.sqrt(low * high)
    else:
        centres = places + widths / 2
    middle = [piece.nats_per_tick for piece in pieces]
    bars = whiskers(middle, [p.low for p in pieces], [p.high for p in pieces])
    axes.errorbar(centres, values(middle), bars, fmt="none", ecolor=BLACK, elinewidth=0.8)
    if not edged:
        axes.set_xticks(np.arange(len(pieces)), [shorten(p.label, 14) for p in pieces])
    axes.axhline(0.0, color=BLACK, lw=0.6)
    axes.set_xlabel(label)
    axes.set_ylabel(_NATS)


def bins(binnings: Sequence[Binning]) -> str:
    """Draw the gap by bins of what may make it larger."""

    def paint(figure: Figure) -> None:
        all_axes = figure.subplots(1, len(binnings), squeeze=False)[0]
        for axes, binning in zip(all_axes, binnings, strict=True):
            unit = f" [{binning.unit}]" if binning.unit else ""
            # bins are of equal rank whatever their width, so each has the same room
            plain = [p.model_copy(update={"start": None, "stop": None}) for p in binning.pieces]
            _pieces(axes, plain, shorten(binning.title, 48) + unit)
            if len(plain) > 5 or max(len(piece.label) for piece in plain) > _LONG:
                axes.tick_params(axis="x", labelrotation=30, labelsize=8)

    said = "The gap by bin. Hatched: not resolved at 99.5 %; bars: 90 %."
    return picture(said, (10.0, 2.6), paint)


def lags(profile: LagProfile) -> str:
    """Draw the slope of the innovation on earlier changes of the setpoints."""

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        ages = np.array(profile.lags)
        bars = (
            whiskers(profile.slope, profile.low, profile.high)
            if profile.low and profile.high
            else None
        )
        axes.errorbar(
            ages, values(profile.slope), bars, fmt="o", ms=4, color=BLUE, label="nominal model"
        )
        if profile.refit:
            axes.plot(ages + 0.12, values(profile.refit), "s", ms=4, color=RED, label="with causes")
        axes.axhline(0.0, color=BLACK, lw=0.6)
        axes.set_xticks(ages)
        axes.set_xlabel("lag [ticks]; 1 is that of the loop")
        axes.set_ylabel("slope on R·Δu [1]")
        axes.legend()

    return picture(
        "Slope of the innovation on the orbit that earlier changes should have made; zero when "
        "the model is right.",
        (7.5, 2.6),
        paint,
    )
