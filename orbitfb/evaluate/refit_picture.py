"""The picture of an evaluation of refits."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from orbitfb.evaluate.refit import RefitResult

_COLOURS = {"told": "black", "frozen": "tab:blue", "naive": "tab:red", "ours": "tab:green"}
_LABELS = {
    "told": "told the true R",
    "frozen": "frozen R",
    "naive": "naive least squares",
    "ours": "ours",
}
_WINDOW = 50
_UM = 1e6


def draw(result: "RefitResult", path: Path) -> None:
    """Draw the orbit under the four laws, the slopes of the estimates, the errors of ours.

    Args:
        result: What was evaluated.
        path: Where the PNG goes.
    """
    figure = Figure(figsize=(12, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    orbit, slopes, errors = figure.subplots(1, 3, width_ratios=(2.2, 1, 1.2))
    for law, series in result.true_rms.items():
        smooth = np.sqrt(np.convolve(series**2, np.ones(_WINDOW) / _WINDOW, mode="valid"))
        ticks = np.arange(len(smooth)) + _WINDOW
        orbit.semilogy(ticks, smooth * _UM, color=_COLOURS[law], label=_LABELS[law], lw=1)
    told = result.figures["rms_told"] * _UM
    orbit.set_ylim(0.5 * told, None)
    orbit.set_xlabel("tick")
    orbit.set_ylabel(f"true orbit, rms over {_WINDOW} ticks [µm]")
    settings = result.settings
    orbit.set_title(f"drift: {settings.drift}, {settings.ticks} ticks, seed {settings.seed}")
    orbit.legend()
    names = [name for name in ("gain_ours", "gain_naive") if name in result.figures]
    colours = [_COLOURS[name.removeprefix("gain_")] for name in names]
    slopes.bar(
        [name.removeprefix("gain_") for name in names],
        [result.figures[name] for name in names],
        color=colours,
    )
    slopes.axhline(1.0, color="black", lw=1)
    if "gain_naive_expected" in result.figures:
        slopes.axhline(result.figures["gain_naive_expected"], color="tab:red", ls="--", lw=1)
    slopes.set_ylabel("slope of R̂ on R, excited directions [1]")
    slopes.set_title("1: right; dashed: bias expected")
    bins = np.linspace(-4, 4, 81)
    errors.hist(result.errors.ravel(), bins=list(bins), density=True, color=_COLOURS["ours"])
    errors.plot(bins, np.exp(-(bins**2) / 2) / np.sqrt(2 * np.pi), color="black", lw=1)
    errors.set_xlabel("error of our R̂ / stated σ [1]")
    errors.set_ylabel("density [1]")
    errors.set_title("black: standard normal")
    figure.savefig(path, dpi=110)
