"""What the kick experiment leaves: figures as JSON, a table, a picture."""

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from orbitfb.evaluate.kick.experiment import KickResult
from orbitfb.evaluate.kick.figures import FLOOR, NEAR, mean_course
from orbitfb.evaluate.kick.laws import LABELS
from orbitfb.evaluate.kick.settings import Law

_COLOURS: dict[Law, str] = {
    "svd": "tab:blue",
    "told": "black",
    "adaptive": "tab:cyan",
    "network": "tab:green",
    "told-network": "tab:gray",
}
_UM = 1e6


def write(result: KickResult, directory: Path) -> None:
    """Write `kick.json`, `kick.md` and `kick.png`.

    Args:
        result: What to write.
        directory: Where; made when it is not there.
    """
    directory.mkdir(parents=True, exist_ok=True)
    laws: dict[str, Any] = {}
    for law, run in result.runs.items():
        laws[law] = {
            **run.figures(result.settings.kicks),
            "state": run.state,
            "reason": run.reason,
            "courses_m": [recovery.course.tolist() for recovery in run.recoveries],
            "reports": [asdict(report) for report in run.reports],
        }
    document = {
        "wrong": dict(result.wrong),
        "laws": laws,
        "seed": result.settings.seed,
        "settings": result.settings.model_dump(mode="json"),
    }
    text = json.dumps(_finite(document), indent=1, allow_nan=False)
    (directory / "kick.json").write_text(text + "\n", encoding="utf-8")
    (directory / "kick.md").write_text(table(result), encoding="utf-8")
    draw(result, directory / "kick.png")


def table(result: KickResult) -> str:
    """Write the table: a row for every law."""
    settings, wrong = result.settings, result.wrong
    lines = [
        "# Random kicks",
        "",
        f"{settings.kicks} kicks of {settings.kick_rms * _UM:g} µm rms, {settings.window} ticks "
        f"apart, through Channel Access at {settings.rate_hz:g} ticks per second; planes "
        f"{settings.planes}, seed {settings.seed}. The controllers' R is off by "
        f"{100 * wrong['relative_error']:.2g} % (Frobenius; drift `{settings.error}` from the "
        f"beginning, entries {settings.matrix_error:g} m/A more); the error's spectral norm is "
        f"{wrong['error_over_weakest']:.3g} times the smallest singular value of the ring's R, "
        f"and the SVD law on it grows by {wrong['growth_svd']:.4f} per tick in its worst mode. "
        f"The learner's prior is {settings.prior}. Of the true orbit; median (worst) over the "
        "kicks.",
        "",
        "| law | kicks recovered | steps to 0.05 mm | steps to 0.5 µm | highest after a kick, "
        "of the kick | rms at the end [µm] | promoted | rolled back | ended |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for law, run in result.runs.items():
        figures = run.figures(settings.kicks)
        cells = [
            LABELS[law],
            *_recovery_cells(figures, run.asked, settings.kicks),
            f"{figures['promoted']:.0f}",
            f"{figures['rolled_back']:.0f}",
            run.ending(settings.kicks),
        ]
        lines.append("| " + " | ".join(cells) + " |")
    ends = [
        f"- {LABELS[law]}, {run.ending(settings.kicks)}: {run.reason}"
        for law, run in result.runs.items()
        if run.reason
    ]
    return "\n".join([*lines, *(["", *ends] if ends else [])]) + "\n"


def draw(result: KickResult, path: Path) -> None:
    """Draw the mean over the kicks and the worst of each law, and each law's whole run."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    after, whole = figure.subplots(1, 2, width_ratios=(1.2, 1))
    for law, run in result.runs.items():
        colour = _COLOURS[law]
        after.plot([], [], color=colour, label=LABELS[law])
        if run.recoveries:
            mean, worst = mean_course(run.recoveries)
            steps = np.arange(len(mean))
            after.loglog(steps + 1, mean * _UM, color=colour)
            after.loglog(steps + 1, worst * _UM, color=colour, lw=0.7, ls=":")
        whole.semilogy(run.true_rms * _UM, color=colour, lw=0.8, label=LABELS[law])
    for goal in (NEAR, FLOOR):
        after.axhline(goal * _UM, color="tab:red", lw=0.6, ls="--")
    after.set_xlabel("corrections since the kick, plus 1")
    after.set_ylabel("true orbit, rms [µm]")
    after.set_title("mean over the kicks; dotted: worst; dashed: 0.05 mm, 0.5 µm", fontsize=10)
    after.legend(fontsize=8)
    wrong, settings = result.wrong, result.settings
    whole.set_xlabel("tick")
    whole.set_title(
        f"R off by {100 * wrong['relative_error']:.2g} % ({settings.error}), "
        f"seed {settings.seed}, {settings.rate_hz:g} Hz",
        fontsize=10,
    )
    figure.savefig(path, dpi=110)


def _recovery_cells(figures: dict[str, float], asked: int, planned: int) -> list[str]:
    """Give the cells about the kicks; a loop that was never kicked did not fail to recover."""
    recovered = f"{figures['recovered']:.0f} of {planned}"
    if not asked:
        return [f"{recovered}, none made", *["not kicked"] * 4]
    return [
        recovered if asked == planned else f"{recovered}, {asked} made",
        _pair(figures, "steps_to_near"),
        _pair(figures, "steps_to_floor"),
        f"{figures['overshoot_worst']:.3f}" if "overshoot_worst" in figures else "",
        _pair(figures, "end", _UM),
    ]


def _pair(figures: dict[str, float], name: str, scale: float = 1.0) -> str:
    median, worst = figures[name] * scale, figures[f"{name}_worst"] * scale
    return f"{_cell(median)} ({_cell(worst)})"


def _cell(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else "never"


def _finite(value: Any) -> Any:
    """Replace what JSON has no word for: inf and NaN become null."""
    if isinstance(value, dict):
        return {name: _finite(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
