"""A dashboard: its panels one after the other, from left to right, line by line."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from deploy.grafana.panels import COLUMNS, DATASOURCE, Panel, panel_json

ROW = "row"


@dataclass(frozen=True, slots=True)
class Dashboard:
    """One dashboard.

    Args:
        name: `shift`, `learning`, ...; also of its file and uid.
        title: For people.
        about: What it is for.
        rows: (heading, panels) from top to bottom.
        past: How far back it looks at first.
    """

    name: str
    title: str
    about: str
    rows: tuple[tuple[str, tuple[Panel, ...]], ...]
    past: str = "now-1h"


def dashboard_json(dashboard: Dashboard) -> dict[str, Any]:
    """Return a dashboard as Grafana's JSON.

    Args:
        dashboard: The dashboard.

    Raises:
        ValueError: A panel is wider than the dashboard.
    """
    panels: list[dict[str, Any]] = []
    below = 0
    for heading, row in dashboard.rows:
        panels.append(_heading(heading, len(panels) + 1, below))
        below = _place(row, panels, below + 1)
    return {
        "uid": f"orbitfb-{dashboard.name}",
        "title": dashboard.title,
        "description": dashboard.about,
        "tags": ["orbitfb"],
        "schemaVersion": 41,
        "version": 1,
        "editable": False,
        "graphTooltip": 1,
        "refresh": "5s",
        "time": {"from": dashboard.past, "to": "now"},
        "timezone": "browser",
        "templating": {"list": [_DATASOURCE_VARIABLE, _INSTANCE_VARIABLE]},
        "links": [
            {
                "type": "dashboards",
                "title": "Orbit feedback",
                "tags": ["orbitfb"],
                "asDropdown": False,
                "includeVars": True,
                "keepTime": True,
            }
        ],
        "annotations": {"list": [_SWAPS]},
        "panels": panels,
    }


def _place(row: Sequence[Panel], panels: list[dict[str, Any]], top: int) -> int:
    """Append panels line by line; return the first free row of the grid below them."""
    x = tallest = 0
    for panel in row:
        if panel.width > COLUMNS:
            raise ValueError(f"panel {panel.title!r} is wider than {COLUMNS} columns")
        if x + panel.width > COLUMNS:
            x, top, tallest = 0, top + tallest, 0
        panels.append(panel_json(panel, len(panels) + 1, x, top))
        x, tallest = x + panel.width, max(tallest, panel.height)
    return top + tallest


def _heading(title: str, number: int, y: int) -> dict[str, Any]:
    return {
        "id": number,
        "type": ROW,
        "title": title,
        "collapsed": False,
        "panels": [],
        "gridPos": {"h": 1, "w": COLUMNS, "x": 0, "y": y},
    }


_DATASOURCE_VARIABLE = {
    "name": "datasource",
    "label": "Prometheus",
    "type": "datasource",
    "query": "prometheus",
    "current": {},
    "hide": 0,
    "includeAll": False,
    "multi": False,
    "regex": "",
    "refresh": 1,
}
_INSTANCE_VARIABLE = {
    "name": "instance",
    "label": "Service",
    "type": "query",
    "datasource": DATASOURCE,
    "query": {"query": "label_values(orbitfb_uptime_seconds, instance)", "refId": "instance"},
    "definition": "label_values(orbitfb_uptime_seconds, instance)",
    "current": {},
    "hide": 0,
    "includeAll": False,
    "multi": False,
    "regex": "",
    "refresh": 2,
    "sort": 1,
}
_SWAPS = {
    "name": "Policy swaps",
    "datasource": DATASOURCE,
    "enable": True,
    "hide": False,
    "iconColor": "blue",
    "expr": 'increase(orbitfb_policy_swaps_total{instance=~"$instance"}[2m]) > 0',
    "titleFormat": "The policy changed",
    "step": "15s",
}
