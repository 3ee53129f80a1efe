"""Pictures of predictions and of what is left: k steps, closed loop, cosines, audit."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import norm

from orbitfb.diagnose.answer_blocks import Audit, ClosedLoop, HeatMap, Identifiability, KStep
from orbitfb.diagnose.report.draw import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    PURPLE,
    RED,
    known,
    picture,
    values,
    whiskers,
)
from orbitfb.diagnose.report.map_pictures import paint_heat


def k_steps(steps: Sequence[KStep]) -> str:
    """Draw how the error of the prediction grows with its length."""

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        ks = np.array([step.k for step in steps], dtype=float)
        lines = (
            ("nominal model", [s.nominal_um for s in steps], BLUE, "o-"),
            ("with the causes", [s.effect_um for s in steps], RED, "s-"),
            ("refitted R (competitor)", [s.competitor_um for s in steps], PURPLE, "^--"),
            ("forward net", [s.net_um for s in steps], ORANGE, "v--"),
        )
        for label, heights, colour, look in lines:
            if known(heights):
                axes.plot(ks, values(heights), look, color=colour, ms=5, label=label)
        for ends, middle, colour in (
            ([(s.nominal_low, s.nominal_high) for s in steps], lines[0][1], BLUE),
            ([(s.effect_low, s.effect_high) for s in steps], lines[1][1], RED),
        ):
            bars = whiskers(middle, [low for low, _ in ends], [high for _, high in ends])
            axes.errorbar(ks, values(middle), bars, fmt="none", ecolor=colour, elinewidth=1)
        faint = [step for step in steps if not step.resolved and step.nominal_um is not None]
        if faint:
            axes.plot(
                [step.k for step in faint],
                values([step.nominal_um for step in faint]),
                "o",
                ms=10,
                mfc="none",
                mec=GREY,
                label="not resolved",
            )
        axes.set_xscale("log")
        axes.set_xticks(ks, [f"{k:g}" for k in ks])
        axes.minorticks_off()
        axes.set_ylim(min(0.0, axes.get_ylim()[0]), None)
        axes.set_xlabel("ticks ahead")
        axes.set_ylabel("excess over the floor, rms [µm]")
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)

    return picture(
        "Error of a prediction k ticks ahead, replaying the logged actions, over what noise and "
        "drift alone would leave.",
        (7.5, 3.1),
        paint,
    )


def closed_loop(its: ClosedLoop) -> str:
    """Draw the predicted orbit rms beside the measured, and the spectra."""

    def paint(figure: Figure) -> None:
        spectra = len(its.frequency_hz) > 1 and known(its.psd_measured)
        if spectra:
            bars, lines = figure.subplots(1, 2, width_ratios=(1, 1.5))
            _spectra(lines, its)
        else:
            bars = figure.subplots()
        rows = (
            ("nominal", its.without_um, None, None, BLUE),
            ("with causes", its.with_um, its.with_low, its.with_high, RED),
            ("measured", its.measured_um, its.measured_low, its.measured_high, BLACK),
        )
        shown = [row for row in rows if row[1] is not None]
        heights = [row[1] for row in shown]
        bars.bar([row[0] for row in shown], values(heights), color=[row[4] for row in shown])
        ends = whiskers(heights, [row[2] for row in shown], [row[3] for row in shown])
        bars.errorbar(range(len(shown)), values(heights), ends, fmt="none", ecolor=GREY, capsize=4)
        for index, height in enumerate(heights):
            bars.annotate(
                f"{height:.3g}",
                (index, (height or 0.0) + float(ends[1, index])),
                xytext=(0, 3),
                textcoords="offset points",
                ha="center",
                fontsize=8,
            )
        bars.margins(y=0.15)
        bars.tick_params(axis="x", labelrotation=20)
        bars.set_ylabel("orbit, rms [µm]")

    said = (
        "The orbit about its reference in the closed loop: simulated with the noise of the floor, "
        "and measured. The bar of the prediction is where 90 % of records would lie by their noise "
        "alone; that of the measured one is of blocks of the record."
    )
    return picture(said, (10.0, 3.1), paint)


def _spectra(axes: Axes, its: ClosedLoop) -> None:
    frequencies = values(its.frequency_hz)
    for label, spectrum, colour, width in (
        ("measured", its.psd_measured, BLACK, 1.4),
        ("nominal", its.psd_without, BLUE, 1.0),
        ("with causes", its.psd_with, RED, 1.0),
    ):
        if len(spectrum) == len(frequencies):
            axes.loglog(frequencies, values(spectrum), color=colour, lw=width, label=label)
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel("PSD of the orbit [µm²/Hz]")
    axes.legend()


def cosines(its: Identifiability) -> str:
    """Draw how alike the best kinds of effects look in this record."""
    grid = np.array([values(row) for row in its.cosine])
    content = HeatMap(
        title="",
        row_label="",
        column_label="",
        values=its.cosine,
        row_names=its.effects,
        column_names=its.effects,
        unit="cosine [1]",
        signed=True,
    )
    side = min(6.5, 0.35 * len(grid) + 2.4)
    return picture(
        "Cosine between the changes that two effects make to the prediction: ±1 cannot be told "
        "apart; grey: not resolved.",
        (side + 1.4, side),
        lambda figure: paint_heat(figure.subplots(), content, grid),
    )


def audit(its: Audit) -> str:
    """Draw quantiles against the normal ones, and the autocorrelation of what is left."""
    quantiles, echo = known(its.quantiles), known(its.autocorrelation)
    if not (quantiles or echo):
        return ""

    def paint(figure: Figure) -> None:
        all_axes = iter(figure.subplots(1, quantiles + echo, squeeze=False)[0])
        if quantiles:
            _quantiles(next(all_axes), its)
        if echo:
            _echo(next(all_axes), its)

    return picture("What is left when all causes are in the model.", (9.5, 3.1), paint)


def _quantiles(axes: Axes, its: Audit) -> None:
    found = np.sort(values(its.quantiles))
    wanted = norm.ppf((np.arange(len(found)) + 0.5) / len(found))
    axes.plot(wanted, wanted, color=GREY, lw=1)
    axes.plot(wanted, found, ".", ms=4, color=BLUE)
    axes.set_xlabel("normal quantile [σ]")
    axes.set_ylabel("whitened innovation [σ]")
    axes.set_title("on the line: as the noise model says")


def _echo(axes: Axes, its: Audit) -> None:
    found = values(its.autocorrelation)
    axes.bar(np.arange(1, len(found) + 1), found, color=BLUE, width=0.6)
    if its.autocorrelation_limit is not None:
        for limit in (-its.autocorrelation_limit, its.autocorrelation_limit):
            axes.axhline(limit, color=RED, ls="--", lw=0.8)
    axes.axhline(0.0, color=BLACK, lw=0.6)
    axes.set_xlabel("lag [ticks]")
    axes.set_ylabel("autocorrelation [1]")
    axes.set_title("white within the dashed lines")
