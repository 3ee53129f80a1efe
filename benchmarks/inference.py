"""Measure what a decision costs: `python -m benchmarks.inference --out benchmarks/inference.json`.

One orbit in, one change out, all laws in turn in one process and on one thread, so that a noisy
computer is noisy for all of them: believe the ratios. Set OMP_NUM_THREADS=1 and
OPENBLAS_NUM_THREADS=1.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.circumstances import circumstances
from orbitfb.nets.perceptron import Perceptron
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.embedding import embed, reembed
from orbitfb.policies.modal import ModalPolicy, ModalSettings
from orbitfb.policies.network import NetworkPolicy, network_sizes
from orbitfb.policies.svd import SvdPolicy, SvdSettings

ROUND = 50
"""Calls of one law in a row: as in a loop, its weights are in the cache if they fit."""

Decide = Callable[[np.ndarray], Any]


def laws() -> dict[str, Decide]:
    """Give every law as a function of the orbit error."""
    matrix = response(Ring.load(), "x")
    valid = np.ones(len(matrix), dtype=np.bool_)
    module = Perceptron(network_sizes(*matrix.shape), seed=0)
    network = NetworkPolicy(module.arrays(), matrix)
    modal = ModalPolicy(matrix, ModalSettings())
    linear = ModalPolicy(matrix, ModalSettings(threshold=None))
    svd = SvdPolicy(matrix, SvdSettings())
    embedded = embed(modal)
    frozen = torch.jit.freeze(
        torch.jit.trace(module.eval(), torch.zeros(len(matrix)), check_trace=False)
    )

    def eager(error: np.ndarray) -> torch.Tensor:
        with torch.inference_mode():
            return module(torch.from_numpy(error.astype(np.float32)))

    def traced(error: np.ndarray) -> torch.Tensor:
        with torch.inference_mode():
            return frozen(torch.from_numpy(error.astype(np.float32)))

    return {
        "network (dense 3x512), numpy": lambda e: network.act(e, valid, None),
        "network (dense 3x512), torch eager": eager,
        "network (dense 3x512), torch traced": traced,
        "network (embedded law), numpy": lambda e: embedded.act(e, valid, None),
        "modal": lambda e: modal.act(e, valid, None),
        "modal, linear": lambda e: linear.act(e, valid, None),
        "svd": lambda e: svd.act(e, valid, svd.initial_state()),
    }


def measure(rounds: int) -> dict[str, dict[str, float]]:
    """Time every law, in turns; durations in µs."""
    rng = np.random.default_rng(0)
    errors = 1e-5 * rng.normal(size=(ROUND, 180))
    samples: dict[str, list[float]] = {}
    decisions = laws()
    for decide in decisions.values():
        for error in errors:
            decide(error)
    for _ in range(rounds):
        for name, decide in decisions.items():
            for error in errors:
                start = time.perf_counter()
                decide(error)
                samples.setdefault(name, []).append(time.perf_counter() - start)
    return {name: _percentiles(taken) for name, taken in samples.items()}


def build(repeats: int) -> dict[str, dict[str, float]]:
    """Time what a swap needs; durations in µs."""
    matrix = response(Ring.load(), "x")
    law = ModalPolicy(matrix, ModalSettings())
    again = ModalPolicy(1.01 * matrix, ModalSettings(), modes=law.modes)
    policy = embed(law)
    steps: dict[str, Callable[[], Any]] = {
        "embed": lambda: embed(law),
        "reembed": lambda: reembed(policy, again),
        "gain matrix": lambda: NetworkPolicy(policy.weights, matrix, policy_id="x").gain_matrix,
    }
    figures = {}
    for name, step in steps.items():
        taken = []
        for _ in range(repeats):
            start = time.perf_counter()
            step()
            taken.append(time.perf_counter() - start)
        figures[name] = _percentiles(taken)
    return figures


def _percentiles(seconds: list[float]) -> dict[str, float]:
    return {
        f"p{percent}": round(float(np.percentile(seconds, percent)) * 1e6, 2)
        for percent in (1, 50, 99)
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="JSON file to write")
    parser.add_argument("--rounds", type=int, default=100, help=f"of {ROUND} calls of every law")
    options = parser.parse_args()
    torch.set_num_threads(1)
    decisions, building = measure(options.rounds), build(20)
    slow = decisions["network (dense 3x512), torch eager"]
    for name, figures in decisions.items():
        figures["torch_eager_over_this"] = round(slow["p50"] / figures["p50"], 2)
        print(
            f"{name:36s} p50 {figures['p50']:7.1f} µs  p99 {figures['p99']:7.1f} µs  "
            f"torch eager / this {figures['torch_eager_over_this']:6.2f}"
        )
    for name, figures in building.items():
        print(f"{name:36s} p50 {figures['p50'] / 1e3:7.2f} ms  p99 {figures['p99'] / 1e3:7.2f} ms")
    if options.out is not None:
        command = " ".join(["python -m benchmarks.inference", *sys.argv[1:]])
        content = {
            "about": circumstances(command, options.rounds, False),
            "decisions_us": decisions,
            "building_us": building,
        }
        options.out.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
