"""The picture of an evaluation of refits."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from orbitfb.core.signals import Vector

_COLOURS = {"told": "black", "frozen": "tab:blue", "naive": "tab:red", "ours": "tab:green"}
_LABELS = {
    "told": "told the true R",
    "frozen": "frozen R",
    "naive": "naive least squares",
    "ours": "ours",
}
_WINDOW = 50
_UM = 1e6


def draw(
    path: Path,
    title: str,
    figures: Mapping[str, float],
    true_rms: Mapping[str, Vector],
    errors: Vector,
) -> None:
    """Draw the orbit under the four laws, the slopes of the estimates, the errors of ours.

    Args:
        path: Where the PNG goes.
        title: What was run: drift, length and seed.
        figures: The figures of the evaluation by name, `rms_told` [m] among them.
        true_rms: By law: rms of the true orbit at every tick [m].
        errors: Errors of our R̂ in stated standard deviations, any shape [1].
    """
    figure = Figure(figsize=(12, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    orbit, slopes, spread = figure.subplots(1, 3, width_ratios=(2.2, 1, 1.2))
    for law, series in true_rms.items():
        smooth = np.sqrt(np.convolve(series**2, np.ones(_WINDOW) / _WINDOW, mode="valid"))
        ticks = np.arange(len(smooth)) + _WINDOW
        orbit.semilogy(ticks, smooth * _UM, color=_COLOURS[law], label=_LABELS[law], lw=1)
    told = figures["rms_told"] * _UM
    orbit.set_ylim(0.5 * told, None)
    orbit.set_xlabel("tick")
    orbit.set_ylabel(f"true orbit, rms over {_WINDOW} ticks [µm]")
    orbit.set_title(title)
    orbit.legend()
    names = [name for name in ("gain_ours", "gain_naive") if name in figures]
    colours = [_COLOURS[name.removeprefix("gain_")] for name in names]
    slopes.bar(
        [name.removeprefix("gain_") for name in names],
        [figures[name] for name in names],
        color=colours,
    )
    slopes.axhline(1.0, color="black", lw=1)
    if "gain_naive_expected" in figures:
        slopes.axhline(figures["gain_naive_expected"], color="tab:red", ls="--", lw=1)
    slopes.set_ylabel("slope of R̂ on R, excited directions [1]")
    slopes.set_title("1: right; dashed: bias expected")
    bins = np.linspace(-4, 4, 81)
    spread.hist(errors.ravel(), bins=list(bins), density=True, color=_COLOURS["ours"])
    spread.plot(bins, np.exp(-(bins**2) / 2) / np.sqrt(2 * np.pi), color="black", lw=1)
    spread.set_xlabel("error of our R̂ / stated σ [1]")
    spread.set_ylabel("density [1]")
    spread.set_title("black: standard normal")
    figure.savefig(path, dpi=110)
