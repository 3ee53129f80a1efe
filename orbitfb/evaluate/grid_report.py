"""What a campaign leaves: figures as JSON, a table, a picture."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from orbitfb.evaluate.grid import GridRow, GridSettings, Spread

_UM = 1e6
_SHOWN = ("frozen", "naive", "ours")
_COLOURS = {"frozen": "tab:blue", "naive": "tab:red", "ours": "tab:green"}
_LABELS = {"frozen": "frozen R", "naive": "naive least squares", "ours": "ours"}


def write(settings: GridSettings, rows: Sequence[GridRow], directory: Path) -> None:
    """Write `campaign.json`, `campaign.md` and `campaign.png`.

    Args:
        settings: What was evaluated.
        rows: What came out.
        directory: Where; made when it is not there.
    """
    directory.mkdir(parents=True, exist_ok=True)
    document = {
        "settings": settings.model_dump(mode="json"),
        "rows": [
            {
                "drift": row.drift,
                "bpm_noise": row.bpm_noise,
                "ticks": row.ticks,
                "figures": {name: asdict(spread) for name, spread in row.spreads().items()},
                "seeds": {str(seed): dict(figures) for seed, figures in row.figures.items()},
            }
            for row in rows
        ],
    }
    text = json.dumps(document, indent=1).replace("NaN", "null").replace("Infinity", "null")
    (directory / "campaign.json").write_text(text + "\n", encoding="utf-8")
    (directory / "campaign.md").write_text(table(settings, rows), encoding="utf-8")
    draw(rows, directory / "campaign.png")


def table(settings: GridSettings, rows: Sequence[GridRow]) -> str:
    """Write the table: median (lowest to highest) over the seeds."""
    seeds = ", ".join(map(str, settings.seeds))
    lines = [
        "# Campaign",
        "",
        f"Rms of the true orbit over the second half of each run: of a loop that is told the true "
        f"R, and of the others over it. Median (lowest to highest) over the seeds {seeds}; "
        f"planes {settings.planes}, gain {settings.policy.gain:g}.",
        "",
        "| drift | BPM noise [µm] | ticks | told the true R [µm] | frozen R | "
        "naive least squares | ours | refits put in force |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        spreads = row.spreads()
        told = spreads["rms_told"]
        cells = [row.drift, f"{row.bpm_noise * _UM:g}", str(row.ticks)]
        cells.append(_cell(Spread(told.median * _UM, told.low * _UM, told.high * _UM)))
        cells += [_cell(spreads[f"rms_ratio_{law}"]) for law in _SHOWN]
        cells.append(_cell(spreads["promoted"]))
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def draw(rows: Sequence[GridRow], path: Path) -> None:
    """Draw the true orbit over that of `told`: a point for each seed, a bar at the median."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(max(5.0, 2.5 + 1.6 * len(rows)), 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for number, law in enumerate(_SHOWN):
        offset = 0.25 * (number - 1)
        for place, row in enumerate(rows):
            ratios = row.values(f"rms_ratio_{law}")
            label = _LABELS[law] if place == 0 else None
            across = place + offset + 0.05 * np.linspace(-1, 1, len(ratios)) * (len(ratios) > 1)
            axes.plot(across, ratios, "o", color=_COLOURS[law], ms=4, alpha=0.6, label=label)
            middle = float(np.median(ratios))
            axes.plot([place + offset - 0.1, place + offset + 0.1], 2 * [middle], color="black")
    axes.axhline(1.0, color="black", lw=0.8, ls="--")
    axes.set_yscale("log")
    axes.set_xticks(
        range(len(rows)),
        [f"{row.drift}\n{row.bpm_noise * _UM:g} µm\n{row.ticks} ticks" for row in rows],
    )
    axes.set_xlim(-0.6, len(rows) - 0.4)
    axes.set_ylabel("true orbit, rms, over that of\na loop told the true R [1]")
    axes.legend(loc="upper left")
    figure.savefig(path, dpi=110)


def _cell(spread: Spread) -> str:
    if spread.low == spread.high:
        return f"{spread.median:.3g}"
    return f"{spread.median:.3g} ({spread.low:.3g} to {spread.high:.3g})"
