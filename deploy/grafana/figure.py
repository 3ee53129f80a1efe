"""Draw the dashboard Shift from a real Prometheus: `python -m deploy.grafana.figure`.

It asks the expressions of the dashboard's own panels and draws the answers with matplotlib. It is
no picture of Grafana, and says so.
"""

import argparse
import json
import math
import urllib.parse
import urllib.request
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deploy.grafana.panels import Panel, Steps
from deploy.grafana.shift import SHIFT, STATES, TIMES_NOISE

OUT = Path("docs/how-to/dashboard-shift.png")
LABEL = "drawn from Prometheus data with matplotlib; not a screenshot of Grafana"
DRAWN = (
    "State over time",
    "Orbit RMS against the noise floor",
    "Worst BPMs",
    "Correctors nearest their limits",
)
_UNITS = {
    "lengthm": (1e6, "µm"),
    "percentunit": (100.0, "%"),
    "none": (1.0, ""),
    TIMES_NOISE: (1.0, "× noise"),
}
_COLOURS = {
    "text": "0.6",
    "green": "tab:green",
    "yellow": "gold",
    "red": "tab:red",
    "blue": "tab:blue",
    "purple": "tab:purple",
}
_STEP = 1.0


@dataclass(frozen=True, slots=True)
class Series:
    """One answer.

    Args:
        name: As the legend says it.
        times: [s since the epoch].
        values: In the unit of the metric.
        style: Of the query.
    """

    name: str
    times: Sequence[float]
    values: Sequence[float]
    style: str


def ask(root: str, panel: Panel, begin: float, end: float) -> list[Series]:
    """Ask the queries of a panel over a time.

    Args:
        root: URL of Prometheus.
        panel: The panel.
        begin: [s since the epoch].
        end: The same.
    """
    found: list[Series] = []
    for query in panel.queries:
        expression = query.expr.replace("$instance", ".*")
        asked = {"query": expression, "start": begin, "end": end, "step": _STEP}
        url = f"{root}/api/v1/query_range?{urllib.parse.urlencode(asked)}"
        with urllib.request.urlopen(url, timeout=30) as answer:
            result: list[dict[str, Any]] = json.load(answer)["data"]["result"]
        for one in result:
            times, values = zip(*((float(t), float(v)) for t, v in one["values"]), strict=True)
            found.append(Series(_legend(query.legend, one["metric"]), times, values, query.axis))
    return found


def _legend(template: str, labels: Mapping[str, str]) -> str:
    for name, value in labels.items():
        template = template.replace(f"{{{{{name}}}}}", value)
    return template


def draw(root: str, begin: float, end: float) -> Figure:
    """Draw the panels; see the module.

    Args:
        root: URL of Prometheus.
        begin: [s since the epoch].
        end: The same.

    Raises:
        OSError: Prometheus does not answer.
        ValueError: It knows nothing of that time.
    """
    panels = {panel.title: panel for _, row in SHIFT.rows for panel in row}
    figure = Figure(figsize=(10, 6.4), layout="constrained")
    grid = figure.add_gridspec(3, 2, height_ratios=(0.5, 2.4, 1.6))
    places = (grid[0, :], grid[1, :], grid[2, 0], grid[2, 1])
    for title, place in zip(DRAWN, places, strict=True):
        panel, axes = panels[title], figure.add_subplot(place)
        series = ask(root, panel, begin, end)
        if not series:
            raise ValueError(f"panel {title!r} has no answer in that time")
        {"state-timeline": _states, "timeseries": _lines, "bargauge": _bars}[panel.kind](
            axes, panel, series, begin
        )
        axes.set_title(title, loc="left", fontsize=10)
    when = datetime.fromtimestamp(end, UTC).isoformat(sep=" ", timespec="minutes")
    figure.suptitle(f"{SHIFT.title}, {when}\n{LABEL}", fontsize=10)
    return figure


def _states(axes: Axes, panel: Panel, series: Sequence[Series], begin: float) -> None:
    for one in series:
        for code, (word, colour) in STATES.items():
            inside = [value == code for value in one.values]
            if any(inside):
                times = [time - begin for time in one.times]
                axes.fill_between(
                    times, 0, 1, where=inside, color=_COLOURS.get(colour, colour), step="post",
                    label=word, linewidth=0.0,
                )  # fmt: skip
    axes.set_yticks([])
    axes.set_xlim(left=0.0)
    axes.legend(ncols=7, fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), frameon=False)


def _lines(axes: Axes, panel: Panel, series: Sequence[Series], begin: float) -> None:
    factor, unit = _UNITS[panel.unit]
    for one in series:
        style: dict[str, Any] = {"linewidth": 1.4}
        if one.style == "floor":
            style = {"linestyle": "--", "color": "0.4"}
        if one.style == "limit":
            style = {"linestyle": ":", "color": "tab:red"}
        times = [time - begin for time in one.times]
        axes.plot(times, [factor * value for value in one.values], label=one.name, **style)
    if panel.extra.get("log"):
        axes.set_yscale("log")
    axes.set_xlim(left=0.0)
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"[{unit}]")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)


def _bars(axes: Axes, panel: Panel, series: Sequence[Series], begin: float) -> None:
    factor, unit = _UNITS[panel.unit]
    newest = max((one.times[-1] for one in series), default=math.nan)
    last = sorted(
        ((one.values[-1], one.name) for one in series if one.times[-1] == newest), reverse=True
    )
    colours = [_COLOURS[_colour(panel.steps, value)] for value, _ in last]
    axes.barh([name for _, name in last], [factor * value for value, _ in last], color=colours)
    axes.invert_yaxis()
    axes.tick_params(labelsize=8)
    axes.set_xlabel(f"[{unit}]")


def _colour(steps: Steps, value: float) -> str:
    return [steps.base, *(colour for bound, colour in steps.steps if value >= bound)][-1]


def main() -> None:
    """Draw the last minutes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--prometheus", default="http://127.0.0.1:9090", help="its address")
    parser.add_argument("--minutes", type=float, default=5.0, help="how far back [5]")
    parser.add_argument("--out", type=Path, default=OUT, help=f"PNG to write [{OUT}]")
    chosen = parser.parse_args()
    end = datetime.now(UTC).timestamp()
    try:
        figure = draw(chosen.prometheus.rstrip("/"), end - 60.0 * chosen.minutes, end)
    except (OSError, ValueError) as error:
        parser.error(f"{chosen.prometheus} gives no data for this: {error}")
    figure.savefig(chosen.out, dpi=110)
    print(chosen.out)


if __name__ == "__main__":
    main()
