"""Answer the records of a suite by the simpler methods.

    python -m tests.blind.baselines --data DIR --out DIR

Prints the names of the methods that answered; what was left out, and why, goes to the screen.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from orbitfb.physics.places import Ring
from tests.blind.baselines import forest, loco
from tests.blind.baselines.residual import Naive, read

Method = Callable[[Naive], dict[str, Any]]


def write(record: Path, second: Path, target: Path, method: Method) -> None:
    """Answer one record in the form of `diagnosis.json`."""
    folder = target / record.stem
    if (folder / "run.json").exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    ring = Ring.load(second, second.with_suffix(".json")) if second.exists() else None
    start = time.monotonic()
    answer = method(read(record, ring))
    seconds = time.monotonic() - start
    (folder / "diagnosis.json").write_text(json.dumps(answer), encoding="utf-8")
    (folder / "run.json").write_text(json.dumps({"exit": 0, "seconds": seconds}), encoding="utf-8")


def naive_tournament(records: list[Path], second: Path, target: Path) -> bool:
    """Ask the diagnosis itself, with the naive residual, if it can be told to use it."""
    command = [sys.executable, "-m", "orbitfb", "diagnose", "record"]
    told = subprocess.run([*command, "--help"], capture_output=True, text=True, check=False)
    if "--residual" not in told.stdout:
        return False
    for record in records:
        folder = target / record.stem
        if (folder / "run.json").exists():
            continue
        folder.mkdir(parents=True, exist_ok=True)
        start = time.monotonic()
        options = ["--out", str(folder), "--json", "--residual", "naive"]
        ended = subprocess.run([*command, str(record), *options], capture_output=True, check=False)
        run = {"exit": ended.returncode, "seconds": time.monotonic() - start}
        (folder / "run.json").write_text(json.dumps(run), encoding="utf-8")
    return True


def main() -> None:
    """Take the command line."""
    parser = argparse.ArgumentParser(description="Answer a suite by simpler methods.")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    records = sorted((options.data / "records").glob("*.npz"))
    second = options.data / "second-ring.csv"
    done = ["loco"]
    with ProcessPoolExecutor(options.jobs) as pool:
        list(pool.map(partial(_loco, second, options.out / "loco"), records))
        trees = forest.train(options.out / "training", pool)
    if trees is None:
        print("left out: forest (scikit-learn is not installed)", file=sys.stderr)
    else:
        for record in records:
            write(record, second, options.out / "forest", partial(forest.answer, forest=trees))
        done.append("forest")
    if naive_tournament(records, second, options.out / "naive"):
        done.append("naive")
    else:
        print("left out: naive (the diagnosis has no --residual)", file=sys.stderr)
    print(" ".join(done))


def _loco(second: Path, target: Path, record: Path) -> None:
    write(record, second, target, loco.answer)


if __name__ == "__main__":
    main()
