"""Measure what each part of the adaptive method is worth.

    python -m benchmarks.ingredients --output benchmarks/ingredients.json

One part is left out at a time, in three scenarios; some ten minutes on two cores.
"""

import argparse
import json
from pathlib import Path
from typing import Any

from orbitfb.evaluate.campaign import Task, run_tasks
from orbitfb.evaluate.paper.ablation import VARIANTS, ablation

SCENARIOS = ("E2", "s2", "s3")


def one(scenario: str, variant: str, trajectories: int, steps: int) -> dict[str, Any]:
    """Run one row."""
    rows = ablation([scenario], trajectories, steps, variants={variant: VARIANTS[variant]})
    return rows[0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--trajectories", type=int, default=4)
    parser.add_argument("--steps", type=int, default=10_000)
    options = parser.parse_args()
    size = {"trajectories": options.trajectories, "steps": options.steps}
    tasks = [
        Task("benchmarks.ingredients:one", {"scenario": scenario, "variant": variant, **size})
        for scenario in SCENARIOS
        for variant in VARIANTS
    ]
    rows = run_tasks(tasks, progress=lambda done, total: print(f"{done} of {total}", flush=True))
    options.output.write_text(json.dumps({**size, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
