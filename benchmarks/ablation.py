"""Measure what every option of training through the model is worth.

    python -m benchmarks.ablation --output ablation.json

The full table takes about half an hour of one core; --quick a few minutes.
"""

import argparse
import json
import time
from pathlib import Path

import torch

from orbitfb.evaluate.ablation import ablate, variants
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--plane", choices=("x", "y"), default="x")
    parser.add_argument("--quick", action="store_true", help="one seed, no long plain training")
    parser.add_argument("--only", default="", help="rows whose name holds this")
    options = parser.parse_args()
    torch.set_num_threads(1)
    plain = (200,) if options.quick else (200, 1000, 2000)
    seeds = (0,) if options.quick else (0, 1, 2)
    rows = [row for row in variants(200, plain) if options.only in row.name]
    matrix = response(Ring.load(), options.plane)
    began = time.perf_counter()

    def told(name: str) -> None:
        print(f"{time.perf_counter() - began:7.1f} s  {name}", flush=True)

    table = ablate(matrix, rows, seeds=seeds, told=told)
    table["ring"], table["plane"] = "default", options.plane
    options.output.write_text(json.dumps(table, indent=1) + "\n")


if __name__ == "__main__":
    main()
