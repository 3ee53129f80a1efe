"""Run the adaptive network on many rings, to see whether it ever loses one.

    python -m benchmarks.many_rings --output benchmarks/many_rings.json

E2 of the paper's experiment on 20 rings (seeds of the optics and gain errors, of the element errors
and of the trajectories) in both planes, 3 trajectories each; some ten minutes on two cores.
"""

import argparse
import json
from pathlib import Path
from typing import Any

from orbitfb.evaluate.campaign import Task, run_tasks
from orbitfb.evaluate.paper.ablation import ablation

_KEPT = (
    "plane",
    "seed",
    "final_rms_mm",
    "final_true_rms_mm",
    "max_rms_mm",
    "steps_to_0p05",
    "steps_to_0p05_worst",
    "diverged",
    "rekick",
)


def one(seed: int, plane: Any, trajectories: int, steps: int) -> dict[str, Any]:
    """Run one ring in one plane."""
    variants = {"network": ("model-based-rl", {})}
    row = ablation(["E2"], trajectories, steps, plane=plane, seed=seed, variants=variants)[0]
    return {key: row[key] for key in _KEPT}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--rings", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--trajectories", type=int, default=3)
    parser.add_argument("--steps", type=int, default=10_000)
    options = parser.parse_args()
    size = {"trajectories": options.trajectories, "steps": options.steps}
    seeds = range(options.first_seed, options.first_seed + options.rings)
    tasks = [
        Task("benchmarks.many_rings:one", {"seed": seed, "plane": plane, **size})
        for plane in "xy"
        for seed in seeds
    ]
    rows = run_tasks(tasks, progress=lambda done, total: print(f"{done} of {total}", flush=True))
    options.output.write_text(json.dumps({**size, "rows": rows}, indent=1) + "\n")
    for key, pick in (("diverged", sum), ("final_true_rms_mm", max), ("steps_to_0p05_worst", max)):
        print(key, pick(row[key] for row in rows))


if __name__ == "__main__":
    main()
