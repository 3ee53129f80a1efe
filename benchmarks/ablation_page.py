"""Write docs/explanations/policies/ablation.md: `python -m benchmarks.ablation_page`.

From ablation.json (`python -m benchmarks.ablation --quick --output benchmarks/ablation.json`) and
ingredients.json (`python -m benchmarks.ingredients --output benchmarks/ingredients.json`).
"""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs/explanations/policies/ablation.md"
_UM = 1e6

HEAD = """# What each ingredient is worth

This page is written by `python -m benchmarks.ablation_page` from what
`python -m benchmarks.ingredients --output benchmarks/ingredients.json` and
`python -m benchmarks.ablation --quick --output benchmarks/ablation.json` measured.

## The adaptive method

One part is left out at a time, in [the paper's experiment](../paper.md): {trajectories}
trajectories, {steps} ticks, plane and seed of that page. *True*: true orbit, rms, at the end of it;
*steps*: ticks until the mean orbit is within 0.05 mm; *re-kick*: median ticks to 0.05 mm after the
drift; *lost*: trajectories that diverged; *swaps*: how often the gain was renewed, per tick.

| scenario | variant | true [µm] | steps | worst | re-kick | lost | swaps |
|---|---|---|---|---|---|---|---|
"""

TRAINING = """
## Training through the model

Default ring, x plane, seed{plural} {seeds}: every row changes the named option of the training
alone. *Floor*: true orbit at the end with reading noise, on the response that was trained on, and
on others that differ by {spread:.1e} m/A per element; *steps* to 0.05 mm; *ρ*: spectral radius of
the closed loop at zero orbit; *CPU*: seconds of one core.

| training | CPU [s] | ρ | floor [µm] | steps | floor, others [µm] | steps, others |
|---|---|---|---|---|---|---|
"""


def ingredients(result: Mapping[str, Any]) -> str:
    """Write the first table."""
    lines = [
        f"| {row['scenario']} | {row['variant']} | {_number(row['final_true_rms_mm'], 1e3)} "
        f"| {_count(row['steps_to_0p05'])} | {_count(row['steps_to_0p05_worst'])} "
        f"| {_count(row['rekick']['steps_to_0p05_median'])} | {row['diverged']} "
        f"| {row['swaps_per_tick']:.3f} |\n"
        for row in result["rows"]
    ]
    return "".join(lines)


def training(result: Mapping[str, Any]) -> str:
    """Write the second table."""
    lines = []
    for row in result["rows"]:
        known, others = row["known"], row["others"]
        radius = row["spectral_radius"]["median"]
        lines.append(
            f"| {row['name']} | {row['processor_seconds']['median']:.1f} | {_number(radius)} "
            f"| {_floor(known)} | {_count(known['steps']['median'])} "
            f"| {_floor(others)} | {_count(others['steps']['median'])} |\n"
        )
    return "".join(lines)


def _floor(side: Mapping[str, Any]) -> str:
    return "diverged" if side["diverged"]["median"] else _number(side["floor"]["median"], _UM)


def _number(value: float | None, scale: float = 1.0) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{value * scale:.3g}"


def _count(value: float | None) -> str:
    return "never" if value is None or not math.isfinite(value) else f"{value:g}"


def main() -> None:
    """Write the page."""
    parts = json.loads((ROOT / "benchmarks/ingredients.json").read_text())
    options = json.loads((ROOT / "benchmarks/ablation.json").read_text())
    seeds = options["seeds"]
    PAGE.write_text(
        HEAD.format(**parts)
        + ingredients(parts)
        + TRAINING.format(
            plural="s" if len(seeds) > 1 else "",
            seeds=", ".join(map(str, seeds)),
            spread=options["spread"],
        )
        + training(options)
    )


if __name__ == "__main__":
    main()
