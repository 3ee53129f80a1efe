"""Search the settings of the plain Algorithm 1 for the paper's row: 0.00028 mm after 187 steps.

    python -m benchmarks.algorithm_one --out DIR [--iterations 1500] [--rates 1e-4,3e-4,1e-3]
        [--batches 16,64] [--horizons 5,10,20] [--seeds 0,1,2] [--trajectories 8] [--workers 1]

Every combination of learning rate, batch, horizon and seed is trained on the R1 of scenario E1, as
published but for these, and run there without any step of learning on the way. The result of every
combination stays in DIR: the same command goes on where it was interrupted. DIR/search.json has the
table, the best end first. A training that ends in numbers that are not finite is told as such.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from benchmarks.circumstances import circumstances
from orbitfb.core.errors import TrainingError
from orbitfb.evaluate.campaign import run_tasks
from orbitfb.evaluate.paper.environment import simulate
from orbitfb.evaluate.paper.laws import Shared
from orbitfb.evaluate.paper.metrics import figures, summarise
from orbitfb.evaluate.paper.scenarios import PLANE, SEED, make_scenario
from orbitfb.evaluate.pool.task import Task
from orbitfb.policies.training.trajectory import train_trajectory
from orbitfb.policies.training.trajectory_settings import TrajectorySettings

_CHANGE = 1e-3
"""Change that the network calls 1, as in `orbitfb.evaluate.paper.naive` [rad]."""
_TOLD = ("min_rms_mm", "max_rms_mm", "final_rms_mm", "steps_to_0p05", "diverged")
_SEARCHED = ("rates", "batches", "horizons", "seeds")
_LOST = 5.0
"""What a training that failed counts as in the order of the table [mm]."""


def combination(
    rate: float, batch: int, horizon: int, seed: int, iterations: int, trajectories: int, steps: int
) -> dict[str, Any]:
    """Train one combination and run it: the task of the campaign.

    Args:
        rate: Learning rate of Adam [1].
        batch: Trajectories of an iteration [1].
        horizon: Steps of each [1].
        seed: Of start and draws.
        iterations: Steps of Adam [1].
        trajectories: Of the scenario [1].
        steps: Length of its drift [ticks].

    Returns:
        Figures of the run; `failed` says why there are none.
    """
    scenario = make_scenario("E1", plane=PLANE, seed=SEED, steps=steps, after=0)
    settings = TrajectorySettings.paper(
        change_scale=_CHANGE,
        learning_rate=rate,
        batch=batch,
        horizon=horizon,
        seed=seed,
        iterations=iterations,
    )
    try:
        result = train_trajectory(scenario.known(0), settings, device="cpu")
    except TrainingError as error:
        return {"failed": str(error)}
    curves = simulate(scenario, range(trajectories), lambda _: Shared(result.policy))
    found = figures(summarise(curves, steps), scenario)
    return {"seconds": result.figures["seconds"], **{name: found[name] for name in _TOLD}}


def line(row: Mapping[str, Any]) -> str:
    """Say what came of a combination."""
    head = f"{row['rate']:>8g}{row['batch']:>6}{row['horizon']:>8}{row['seed']:>5}"
    if "failed" in row:
        return f"{head}  failed: {row['failed']}"
    return head + "".join(f"{_cell(row[name]):>14}" for name in _TOLD)


def _cell(value: float | None) -> str:
    return "never" if value is None else f"{value:.5g}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, the best end first."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="directory of the results")
    parser.add_argument("--rates", default="1e-4,3e-4,1e-3", help="learning rates, by commas")
    parser.add_argument("--batches", default="16,64", help="by commas")
    parser.add_argument("--horizons", default="5,10,20", help="by commas")
    parser.add_argument("--seeds", default="0,1,2", help="by commas")
    parser.add_argument("--iterations", type=int, default=1500, help="steps of Adam")
    parser.add_argument("--trajectories", type=int, default=8, help="of the scenario")
    parser.add_argument("--steps", type=int, default=10_000, help="length of the drift")
    parser.add_argument("--workers", type=int, default=1, help="local processes")
    options = parser.parse_args(arguments)
    common = {name: getattr(options, name) for name in ("iterations", "trajectories", "steps")}
    grid = [
        {"rate": float(rate), "batch": int(batch), "horizon": int(horizon), "seed": int(seed)}
        for rate, batch, horizon, seed in product(
            *(getattr(options, name).split(",") for name in _SEARCHED)
        )
    ]
    tasks = [Task("benchmarks.algorithm_one:combination", {**cell, **common}) for cell in grid]
    results = run_tasks(
        tasks,
        options.out,
        options.workers,
        progress=lambda done, total: print(f"{done} of {total}", flush=True),
    )
    rows = [{**cell, **found} for cell, found in zip(grid, results, strict=True)]
    rows.sort(key=lambda row: row.get("final_rms_mm", _LOST))
    print("    rate batch horizon seed" + "".join(f"{name:>14}" for name in _TOLD))
    for row in rows:
        print(line(row))
    about = circumstances("python -m benchmarks.algorithm_one", 1, False)
    document = {"about": about, **common, "paper": [0.00028, 187], "rows": rows}
    (options.out / "search.json").write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
