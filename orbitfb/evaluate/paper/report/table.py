"""`table.json` and `table.md`: the figures of every method, beside the paper's."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from orbitfb import __version__
from orbitfb.evaluate.paper.methods import METHODS
from orbitfb.evaluate.paper.metrics import lqg_floor
from orbitfb.evaluate.paper.report.targets import BIAS, PAPER, judge
from orbitfb.evaluate.paper.run import PaperResult
from orbitfb.evaluate.paper.scenarios import PAPER_LAMBDA, Scenario

HEADLINE = "E2"
PAPERS = "E1"

TITLES: Mapping[str, str] = {
    "E1": "the paper's: R1 is known exactly",
    "E2": "R1 is known with errors of 0.8 σ_min in norm",
    "E2h": "R1 is known with errors of 0.02 m/rad per element",
    "E2-clean": "as E2, R1 that of the optics, without near-null modes",
    "s1": "physical, mild drift: setpoints accumulate, ground moves",
    "s2": "physical, strong drift",
    "s3": "physical, strong drift, ill-conditioned",
}

COLUMNS: Mapping[str, str] = {
    "min_rms_mm": "min [mm]",
    "max_rms_mm": "max [mm]",
    "final_rms_mm": "final [mm]",
    "final_true_rms_mm": "final, true [mm]",
    "steps_to_0p05": "steps to 0.05 mm",
    "steps_to_0p05_worst": "worst",
    "diverged": "diverged",
    "rekick.steps_to_0p05_median": "re-kick: steps to 0.05 mm",
    "rekick.steps_to_0p5um_median": "to 0.5 µm",
    "rekick.max_over_kick": "max / kick",
    "true_over_lqg_floor": "true / LQG floor",
    "bias": "mean diagonal of R̂ K over 1 + g/2",
}
"""By the path of the figure."""


def document(result: PaperResult) -> dict[str, Any]:
    """Give all figures as JSON: methods by name for E2, and by scenario.

    Args:
        result: What was run.
    """
    scenarios = {
        name: {
            "title": TITLES[name],
            **_ring(result.scenarios[name]),
            "methods": {method: _method(method, one) for method, one in methods.items()},
        }
        for name, methods in figures_of(result).items()
    }
    return {
        "version": __version__,
        "settings": result.settings.model_dump(mode="json"),
        "paper_lambda": PAPER_LAMBDA,
        "methods": scenarios.get(HEADLINE, {}).get("methods", {}),
        "scenarios": scenarios,
        "paper": PAPER,
        "naive_bias": [dict(one) for one in result.bias],
        "targets": [verdict.as_json() for verdict in judge(_judged(result))],
    }


def figures_of(result: PaperResult) -> dict[str, dict[str, Mapping[str, Any]]]:
    """Give the figures alone, by scenario and method."""
    return {
        name: {method: one.figures for method, one in methods.items()}
        for name, methods in result.methods.items()
    }


def _judged(result: PaperResult) -> dict[str, dict[str, Mapping[str, Any]]]:
    """Give the figures with those of the naive refit's bias as if they were a scenario."""
    bias = {
        f"gain {one['gain']:g}": {"bias": one["found"] / one["expected"]} for one in result.bias
    }
    return {**figures_of(result), BIAS: dict(bias)}


def markdown(table: Mapping[str, Any]) -> str:
    """Write the tables for people.

    Args:
        table: What `document` gave.
    """
    parts = ["# The paper's experiment\n", _settings_line(table["settings"])]
    for name, scenario in table["scenarios"].items():
        parts.append(f"\n## {name}: {scenario['title']}\n")
        parts.append("\n".join(_rows(scenario["methods"], beside=name == PAPERS)) + "\n")
        if scenario["lqg_floor_mm"]:
            parts.append(f"LQG floor of the true orbit: {scenario['lqg_floor_mm']:.4g} mm.\n")
    if table["targets"]:
        parts.append("\n## Targets\n")
        parts.append("\n".join(target_rows(table["targets"])) + "\n")
    return "\n".join(parts)


def cell(value: Any) -> str:
    """Write one figure; never reached is `never`, a fraction has 4 digits."""
    if value is None:
        return "never"
    if isinstance(value, int) or float(value).is_integer():
        return f"{value:.0f}"
    return f"{value:.4g}"


def columns_of(methods: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Give the figures that any of these methods has."""
    return [path for path in COLUMNS if any(has(figures, path) for figures in methods.values())]


def get(figures: Mapping[str, Any], path: str) -> Any:
    """Look a figure up by its path."""
    value: Any = figures
    for part in path.split("."):
        value = value[part]
    return value


def target_rows(targets: list[Mapping[str, Any]]) -> list[str]:
    """Write the targets as rows of a table."""
    rows = [
        "| scenario | method | figure | has to be | found | reached |",
        "|---|---|---|---|---|---|",
    ]
    for target in targets:
        mark = "yes" if target["reached"] else "**no**"
        rows.append(
            f"| {target['scenario']} | {target['method']} | {figure_name(target)} | "
            f"{bounds(target)} | {cell(target['value'])} | {mark} |"
        )
    return rows


def figure_name(target: Mapping[str, Any]) -> str:
    """Say which figure a target is about."""
    name = COLUMNS[target["figure"]] if target["figure"] in COLUMNS else target["figure"]
    if target["over"]:
        return f"{name}, over that of {target['over']}"
    return f"{name}, {target['under']} over this" if target["under"] else name


def bounds(target: Mapping[str, Any]) -> str:
    """Say where a figure has to lie."""
    low, high = target["smallest"], target["largest"]
    if low is None and high is None:
        return "never"
    if low is None:
        return f"≤ {high:.4g}"
    return f"≥ {low:.4g}" if high is None else f"{low:.4g} … {high:.4g}"


def _rows(methods: Mapping[str, Mapping[str, Any]], beside: bool) -> list[str]:
    columns = columns_of(methods)
    heads = ["method", "N", *(COLUMNS[path] for path in columns)]
    rows = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for name, figures in methods.items():
        cells = [cell(get(figures, path)) if has(figures, path) else "" for path in columns]
        rows.append("| " + " | ".join([name, str(figures["trajectories"]), *cells]) + " |")
        if beside and name in PAPER:
            known = PAPER[name]
            cells = [cell(known[path]) if path in known else "" for path in columns]
            rows.append("| " + " | ".join(["*the paper*", "", *cells]) + " |")
    return rows


def has(figures: Mapping[str, Any], path: str) -> bool:
    """Say whether there is a figure of this path, be it one that was never reached."""
    value: Any = figures
    for part in path.split("."):
        if not isinstance(value, Mapping) or part not in value:
            return False
        value = value[part]
    return True


def _settings_line(settings: Mapping[str, Any]) -> str:
    return (
        f"{settings['steps']} ticks of drift, re-kick and {settings['after']} ticks; plane "
        f"{settings['plane']}, seed {settings['seed']}. Mean curve over N trajectories; final is "
        "the mean of its last 100 ticks; never: was not reached.\n"
    )


def _ring(scenario: Scenario) -> dict[str, Any]:
    def condition(matrix: np.ndarray) -> float:
        values = np.linalg.svd(matrix, compute_uv=False)
        return float(values[0] / values[-1])

    return {
        "condition_number_start": condition(scenario.start),
        "condition_number_end": condition(scenario.end),
        "error_entry_m_per_rad": scenario.error_entry,
        "lqg_floor_mm": lqg_floor(scenario) * 1e3,
    }


def _method(name: str, figures: Mapping[str, Any]) -> dict[str, Any]:
    return {"title": METHODS[name].title, "static": METHODS[name].static, **figures}
