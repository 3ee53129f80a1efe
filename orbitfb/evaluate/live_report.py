"""What an evaluation of the live loop leaves: figures as JSON, a picture."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.evaluate.live import LiveRun, figures
from orbitfb.evaluate.live_settings import LiveSettings

_COLOURS = {"told": "black", "frozen": "tab:blue", "ours": "tab:green"}
_LABELS = {"told": "told the true R", "frozen": "frozen R", "ours": "ours"}
_WINDOW = 100
_UM = 1e6


@dataclass(frozen=True, slots=True)
class LiveResult:
    """One seed.

    Args:
        settings: What was run.
        runs: By law.
    """

    settings: LiveSettings
    runs: Mapping[str, LiveRun]


def write(results: Sequence[LiveResult], directory: Path) -> None:
    """Write `live.json` and `live.png`.

    Args:
        results: One for each seed.
        directory: Where; made when it is not there.
    """
    directory.mkdir(parents=True, exist_ok=True)
    document = [
        {
            "seed": result.settings.seed,
            **figures(result.runs),
            "states": {law: run.state for law, run in result.runs.items()},
            "reasons": {law: run.reason for law, run in result.runs.items()},
            "settings": result.settings.model_dump(mode="json"),
            "alarms": {law: [asdict(a) for a in run.alarms] for law, run in result.runs.items()},
            "reports": [asdict(report) for report in result.runs["ours"].reports],
        }
        for result in results
    ]
    text = json.dumps(document, indent=1, default=float).replace("NaN", "null")
    (directory / "live.json").write_text(text + "\n", encoding="utf-8")
    draw(results, directory / "live.png")


def draw(results: Sequence[LiveResult], path: Path) -> None:
    """Draw the true orbit of every law, a panel for each seed."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.5 * len(results), 4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = np.atleast_1d(figure.subplots(1, len(results), sharey=True))
    for panel, result in zip(axes, results, strict=True):
        for law, run in result.runs.items():
            smooth = _smooth(run.true_rms) * _UM
            panel.semilogy(np.arange(len(smooth)), smooth, color=_COLOURS[law], label=_LABELS[law])
        settings = result.settings
        clock = "lockstep" if settings.rate_hz is None else f"{settings.rate_hz:g} Hz"
        kind = settings.policy.kind
        panel.set_title(f"{kind}, drift {settings.drift}, seed {settings.seed}, {clock}")
        panel.set_xlabel("tick")
    axes[0].set_ylabel(f"true orbit, rms over {_WINDOW} ticks [µm]")
    axes[0].legend()
    figure.savefig(path, dpi=110)


def _smooth(values: Vector) -> Vector:
    """Give the running rms of what is known."""
    known = np.isfinite(values)
    window = np.ones(_WINDOW)
    squares = np.convolve(np.where(known, values, 0.0) ** 2, window, mode="valid")
    counts = np.convolve(known.astype(float), window, mode="valid")
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.sqrt(squares / counts)
