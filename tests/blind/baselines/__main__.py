"""Answer the records of a suite by the simpler methods.

    python -m tests.blind.baselines --data DIR --out DIR

Prints the names of the methods that answered; what was left out, and why, goes to the screen.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from orbitfb.cli.blind_processes import answered, command, each, outliving_none, rings_of
from orbitfb.physics.places import Ring
from tests.blind.baselines import forest, loco
from tests.blind.baselines.residual import Naive, read

Method = Callable[[Naive], dict[str, Any]]

NAIVE = 60
"""Records that the diagnosis answers on the naive residual: it takes minutes for each, because
there is always something left to be named. Names are opaque, so the first ones are any."""


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


def naive(data: Path, target: Path, record: Path) -> None:
    """Ask the diagnosis itself, on the naive residual; it is a process of its own."""
    folder = target / record.stem
    if answered(folder / "run.json"):
        return
    folder.mkdir(parents=True, exist_ok=True)
    arguments = [str(record), "--out", str(folder), *rings_of(record, data)]
    later = data / "later" / record.name
    if later.exists():
        arguments += ["--holdout", str(later)]
    command(*arguments, module="tests.blind.baselines.naive").keep(folder / "run.json")


@outliving_none()
def main() -> None:
    """Take the command line."""
    parser = argparse.ArgumentParser(description="Answer a suite by simpler methods.")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--naive", type=int, default=NAIVE, help="records for the naive residual, the slowest"
    )
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
    each(
        partial(naive, options.data, options.out / "naive-residual"),
        records[: options.naive],
        options.jobs,
        "answered by the naive residual",
    )
    done.append("naive-residual")
    print(" ".join(done))


def _loco(second: Path, target: Path, record: Path) -> None:
    write(record, second, target, loco.answer)


if __name__ == "__main__":
    main()
