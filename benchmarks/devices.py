"""Train and run one campaign on every device: what a GPU is worth, and whether results are equal.

    python -m benchmarks.devices [--devices cpu,cuda] [--iterations 300] [--trajectories 32]
                                 [--steps 10000] [--out FILE]

The first device is the reference; by default it is the processor, and beside it a GPU if torch sees
one. All random numbers are drawn on the processor, so that every device sees the same ones: what
differs is rounding. Told are, for every device and over the first:

- a step of Adam of Algorithm 1 in its fast form, 180 × 180, and how far the gains of the trained
  networks are apart, relative to the gain (Frobenius norm);
- a campaign: such a training for scenario E2 of the paper's experiment and its trajectories, and
  how far their final orbits are apart, relative.
"""

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch

from benchmarks.circumstances import circumstances
from orbitfb.core.signals import Vector
from orbitfb.evaluate.paper.environment import simulate
from orbitfb.evaluate.paper.laws import Shared
from orbitfb.evaluate.paper.metrics import figures, summarise
from orbitfb.evaluate.paper.scenarios import PLANE, SEED, make_scenario
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.training.trajectory import train_trajectory
from orbitfb.policies.training.trajectory_settings import TrajectorySettings

_CHANGE = 1e-3
"""Change that the network calls 1 in the scenario [rad]."""


def trained(matrix: Vector, iterations: int, device: str) -> tuple[float, Vector]:
    """Train a network; seconds of an iteration, and its gain near zero, shape (m, n) [A/m]."""
    train_trajectory(matrix, TrajectorySettings(iterations=2), device=device)  # starts the device
    result = train_trajectory(matrix, TrajectorySettings(iterations=iterations), device=device)
    return result.figures["seconds_per_iteration"], result.policy.gain_matrix


def campaign(iterations: int, trajectories: int, steps: int, device: str) -> tuple[float, float]:
    """Train for scenario E2 and run it; seconds, and the final true orbit, rms [mm]."""
    scenario = make_scenario("E2", plane=PLANE, seed=SEED, steps=steps, after=0)
    began = time.perf_counter()
    settings = TrajectorySettings(iterations=iterations, change_scale=_CHANGE)
    result = train_trajectory(scenario.known(0), settings, device=device)
    curves = simulate(scenario, range(trajectories), lambda _: Shared(result.policy))
    seconds = time.perf_counter() - began
    found = figures(summarise(curves, steps), scenario)
    return seconds, float(found["final_true_rms_mm"])


def compare(
    devices: Sequence[str], iterations: int, trajectories: int, steps: int
) -> list[Mapping[str, float | str]]:
    """Measure every device, each one over the first."""
    matrix = response(Ring.load(), "x")
    found: list[Mapping[str, float | str]] = []
    steps_of: list[float] = []
    gains: list[Vector] = []
    campaigns: list[tuple[float, float]] = []
    for device in devices:
        seconds, gain = trained(matrix, iterations, device)
        steps_of.append(seconds)
        gains.append(gain)
        campaigns.append(campaign(iterations, trajectories, steps, device))
        apart = np.linalg.norm(gain - gains[0]) / np.linalg.norm(gains[0])
        found.append(
            {
                "device": device,
                "training step [ms]": 1e3 * seconds,
                "training step, times faster": steps_of[0] / seconds,
                "gains apart": float(apart),
                "campaign [s]": campaigns[-1][0],
                "campaign, times faster": campaigns[0][0] / campaigns[-1][0],
                "final orbits apart": abs(campaigns[-1][1] / campaigns[0][1] - 1.0),
            }
        )
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    present = "cpu,cuda" if torch.cuda.is_available() else "cpu"
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--devices", default=present, help="by commas, the reference first")
    parser.add_argument("--iterations", type=int, default=300, help="steps of Adam")
    parser.add_argument("--trajectories", type=int, default=32, help="of the campaign")
    parser.add_argument("--steps", type=int, default=10_000, help="ticks of the campaign's drift")
    parser.add_argument("--out", type=Path, help="where the figures go as JSON")
    options = parser.parse_args(arguments)
    devices = options.devices.split(",")
    found = compare(devices, options.iterations, options.trajectories, options.steps)
    for name in found[0]:
        print(f"{name:<28}", *(_cell(row[name]) for row in found))
    if "cuda" not in devices:
        print("torch sees no GPU here, or none was asked for: only the processor was measured")
    if options.out is not None:
        command = f"python -m benchmarks.devices --devices {options.devices}"
        about = circumstances(command, 1, False)
        document = {"about": about, "torch": torch.__version__, "devices": found}
        options.out.write_text(json.dumps(document, indent=1) + "\n")


def _cell(value: float | str) -> str:
    return f"{value:>12}" if isinstance(value, str) else f"{value:>12.4g}"


if __name__ == "__main__":
    main()
