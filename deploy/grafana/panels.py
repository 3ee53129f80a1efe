"""Panels of a dashboard as values; Grafana's JSON is made of them in one place."""

from dataclasses import dataclass, field
from typing import Any

GREEN, YELLOW, RED, BLUE, GREY = "green", "yellow", "red", "blue", "text"
DATASOURCE = {"type": "prometheus", "uid": "${datasource}"}
COLUMNS = 24
"""Width of a dashboard."""


@dataclass(frozen=True, slots=True)
class Query:
    """What is asked of Prometheus.

    Args:
        expr: PromQL.
        legend: Name of each series.
        axis: Draw it as `line`, `floor` (dashed, grey), `limit` (dashed, red: here an alert
            fires), `band` (thin) or `bars`.
        unit: Of its own instead of the panel's, in a `stat`; no colour judges such a figure.
    """

    expr: str
    legend: str = ""
    axis: str = "line"
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Steps:
    """Colours by value.

    Args:
        base: Below the first step.
        steps: (value, colour), growing.
        shown: Whether lines are drawn at them.
    """

    base: str = GREEN
    steps: tuple[tuple[float, str], ...] = ()
    shown: bool = False


INFORMATION = Steps(BLUE)
"""Of a figure that is neither good nor bad."""


@dataclass(frozen=True, slots=True)
class Panel:
    """One panel.

    Args:
        kind: `stat`, `timeseries`, `bargauge`, `state-timeline` or `table`.
        title: In the field's words.
        about: What it shows and what to do about it.
        unit: Grafana's unit.
        queries: What it asks.
        width: Of 24 columns.
        steps: Colours by value.
        height: In rows of the grid.
        extra: `min`, `max`, `decimals`, `log`, `stack`, `names` (show the name of the series
            instead of its value), `texts` (value -> (text, colour)).
    """

    kind: str
    title: str
    about: str
    unit: str
    queries: tuple[Query, ...]
    width: int
    steps: Steps
    height: int = 8
    extra: dict[str, Any] = field(default_factory=dict)


def metric(name: str, *conditions: str) -> str:
    """Select a metric of the chosen service.

    Args:
        name: Without `orbitfb_`; one with a colon is a recorded one.
        conditions: More, as `state="CLOSED"`.
    """
    whole = name if name == "up" or name.startswith("orbitfb:") else f"orbitfb_{name}"
    chosen = ", ".join(('instance=~"$instance"', *conditions))
    return f"{whole}{{{chosen}}}"


def panel_json(panel: Panel, number: int, x: int, y: int) -> dict[str, Any]:
    """Return a panel as Grafana's JSON.

    Args:
        panel: The panel.
        number: Its id, unique in the dashboard.
        x: Column of its left edge.
        y: Row of its upper edge.
    """
    at_once = panel.kind in ("stat", "bargauge", "table")
    return {
        "id": number,
        "type": panel.kind,
        "title": panel.title,
        "description": panel.about,
        "datasource": DATASOURCE,
        "gridPos": {"h": panel.height, "w": panel.width, "x": x, "y": y},
        "targets": [
            {
                "refId": chr(ord("A") + place),
                "datasource": DATASOURCE,
                "editorMode": "code",
                "expr": query.expr,
                "legendFormat": query.legend or "__auto",
                "instant": at_once,
                "range": not at_once,
                **({"format": "table"} if panel.kind == "table" else {}),
            }
            for place, query in enumerate(panel.queries)
        ],
        "fieldConfig": {"defaults": _defaults(panel), "overrides": _overrides(panel)},
        "options": _options(panel),
        **({"transformations": _ORGANISED} if panel.kind == "table" else {}),
    }


_ORGANISED = [
    {
        "id": "organize",
        "options": {
            "excludeByName": {"Time": True, "__name__": True, "job": True, "instance": True},
        },
    }
]


def _defaults(panel: Panel) -> dict[str, Any]:
    extra, steps = panel.extra, panel.steps
    texts = extra.get("texts", {})
    defaults: dict[str, Any] = {
        "unit": panel.unit,
        "color": {"mode": "palette-classic" if panel.kind == "timeseries" else "thresholds"},
        "thresholds": {
            "mode": "absolute",
            "steps": [
                {"color": steps.base, "value": None},
                *({"color": colour, "value": value} for value, colour in steps.steps),
            ],
        },
        "mappings": [
            {
                "type": "value",
                "options": {
                    str(value): {"text": text, "color": colour, "index": place}
                    for place, (value, (text, colour)) in enumerate(texts.items())
                },
            }
        ]
        if texts
        else [],
        **{key: extra[key] for key in ("min", "max", "decimals") if key in extra},
    }
    if panel.kind == "timeseries":
        logarithmic = {"type": "log", "log": 10} if extra.get("log") else {"type": "linear"}
        defaults["custom"] = {
            "drawStyle": "line",
            "lineWidth": 1,
            "fillOpacity": 30 if extra.get("stack") else 0,
            "showPoints": "never",
            "spanNulls": False,
            "scaleDistribution": logarithmic,
            "stacking": {"mode": "normal" if extra.get("stack") else "none", "group": "A"},
            "thresholdsStyle": {"mode": "dashed" if steps.shown else "off"},
        }
    return defaults


_STYLES = {
    "floor": [
        {"id": "custom.lineStyle", "value": {"fill": "dash", "dash": [8, 6]}},
        {"id": "color", "value": {"mode": "fixed", "fixedColor": GREY}},
    ],
    "limit": [
        {"id": "custom.lineStyle", "value": {"fill": "dash", "dash": [4, 4]}},
        {"id": "color", "value": {"mode": "fixed", "fixedColor": RED}},
    ],
    "band": [{"id": "custom.lineWidth", "value": 0.5}],
    "bars": [
        {"id": "custom.drawStyle", "value": "bars"},
        {"id": "custom.fillOpacity", "value": 60},
    ],
}


def _overrides(panel: Panel) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    for place, query in enumerate(panel.queries):
        properties = _STYLES.get(query.axis, []) if panel.kind == "timeseries" else []
        if query.unit:
            plain = {"mode": "fixed", "fixedColor": BLUE}
            properties = [
                {"id": "unit", "value": query.unit},
                {"id": "color", "value": plain},
            ]
        if properties:
            matcher = {"id": "byFrameRefID", "options": chr(ord("A") + place)}
            found.append({"matcher": matcher, "properties": properties})
    return found


def _options(panel: Panel) -> dict[str, Any]:
    reduced = {"calcs": ["lastNotNull"], "fields": "", "values": False}
    legend = {"displayMode": "list", "placement": "bottom", "showLegend": True}
    if panel.kind == "stat":
        return {
            "reduceOptions": reduced,
            "colorMode": "value",
            "graphMode": "none",
            "textMode": "name" if panel.extra.get("names") else "auto",
            "justifyMode": "auto",
            "orientation": "auto",
        }
    if panel.kind == "bargauge":
        return {
            "reduceOptions": reduced,
            "displayMode": "basic",
            "orientation": "horizontal",
            "showUnfilled": True,
        }
    if panel.kind == "table":
        return {"showHeader": True, "cellHeight": "sm"}
    if panel.kind == "state-timeline":
        return {"mergeValues": True, "showValue": "auto", "legend": legend}
    return {"legend": legend, "tooltip": {"mode": "multi", "sort": "desc"}}
