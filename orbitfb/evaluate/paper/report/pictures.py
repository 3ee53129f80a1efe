"""Pictures of the paper's experiment: orbits over time, and the course of trainings."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from orbitfb.evaluate.paper.run import MethodResult
from orbitfb.evaluate.paper.scenarios import Scenario

_UM = 1e6
COLOURS: Mapping[str, str] = {
    "svd": "tab:blue",
    "svd-best": "tab:cyan",
    "modal-linear": "tab:olive",
    "modal": "tab:brown",
    "supervised": "tab:orange",
    "supervised-right": "gold",
    "naive-refit": "tab:purple",
    "model-based-rl-verbatim": "tab:pink",
    "forward-net": "navy",
    "forward-net-alone": "slateblue",
    "ppo": "tab:grey",
    "adaptive-linear": "tab:green",
    "model-based-rl": "tab:red",
    "model-based-rl-memoryless": "salmon",
    "true-response": "black",
}
_MOST_POINTS = 1500


def new_figure(width: float, height: float) -> Figure:
    """Begin a figure that is drawn without a screen."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def draw_orbits(
    scenario: Scenario, methods: Mapping[str, MethodResult], ticks: int | None, path: Path
) -> None:
    """Draw what the readings show and the true orbit, mean and worst trajectory.

    Args:
        scenario: What happened.
        methods: What was found, by name.
        ticks: How many of the first ticks; None: all of them, with the re-kick.
        path: Where the PNG goes.
    """
    whole = scenario.steps + scenario.after + 1
    end = whole if ticks is None else min(ticks, scenario.steps)
    figure = new_figure(12.5, 4.8)
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    drawn = thinned(end, scenario.steps)
    widths = np.linspace(2.4, 1.0, len(methods))  # so that one curve on another is still seen
    for (name, result), width in zip(methods.items(), widths, strict=True):
        summary = result.summary
        count = len(summary.near)
        for axes, total, worst in (
            (left, summary.observed_sum, summary.observed_worst),
            (right, summary.true_sum, summary.true_worst),
        ):
            colour = COLOURS[name]
            mean = total[drawn] / count * _UM
            axes.semilogy(drawn, mean, color=colour, lw=width, label=name)
            top = worst[drawn] * _UM
            axes.semilogy(drawn, top, color=colour, lw=0.6, ls=":", alpha=0.8)
    left.axhline(scenario.reading_noise * _UM, color="grey", lw=0.8, ls=":")
    for axes, title in ((left, "read"), (right, "true")):
        axes.set_title(f"{scenario.name}: orbit as {title}" if title == "read" else "true orbit")
        axes.axhline(50.0, color="grey", lw=0.8)
        axes.set_xlabel("tick")
        axes.grid(alpha=0.25)
    left.set_ylabel("rms over BPMs [µm]")
    right.set_ylim(1e-3, 1e4)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        loc="outside right upper",
        fontsize="small",
        title="solid: mean\ndotted: worst\ngrey: 0.05 mm, noise",
        title_fontsize="small",
    )
    figure.savefig(path, dpi=110)


def draw_training(trainings: Mapping[str, Sequence[float]], path: Path) -> None:
    """Draw the loss of every training.

    Args:
        trainings: Loss at every iteration, by title.
        path: Where the PNG goes.
    """
    figure = new_figure(max(4.0, 3.6 * len(trainings)), 3.4)
    for axes, (title, curve) in zip(
        figure.subplots(1, len(trainings), squeeze=False)[0], trainings.items(), strict=True
    ):
        axes.plot(np.arange(1, len(curve) + 1), curve, lw=0.8)
        if min(curve) > 0:
            axes.set_yscale("log")
        axes.set_title(title, fontsize="small")
        axes.set_xlabel("iteration")
        axes.set_ylabel("loss [1]")
        axes.grid(alpha=0.25)
    figure.savefig(path, dpi=110)


def thinned(end: int, kick: int) -> np.ndarray:
    """Give the ticks that are drawn: all if they are few, else some, and all after a re-kick."""
    if end <= _MOST_POINTS:
        return np.arange(end)
    some = np.linspace(0, end - 1, _MOST_POINTS).astype(np.int64)
    return np.unique(np.concatenate((some, np.arange(min(kick, end), min(kick + 100, end)))))
