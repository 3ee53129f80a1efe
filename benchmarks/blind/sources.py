"""Generators of fresh records: the own one, and an external one that is given by its path."""

import os
import random
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from benchmarks.blind.generator.generate import generate
from benchmarks.blind.generator.suites import Suite
from benchmarks.blind.records import Case, read_folder
from benchmarks.blind.workers import ONE_THREAD


class SourceError(Exception):
    """A generator that cannot be used: which, why, what to do."""


def own(out: Path, suite: Suite, seed: int, first: int | None, jobs: int) -> list[Case]:
    """Make cases of the project's own generator; those that are there already are kept.

    Args:
        out: Folder for the records; the truth goes beside it.
        suite: Which cases.
        seed: Of the cases.
        first: Only so many, drawn at random; None: all.
        jobs: Processes.
    """
    records, truth = out / f"own-{suite}-{seed}", out / f"own-{suite}-{seed}_truth"
    chosen = generate(suite, seed, records, truth, jobs, first=first)
    return read_folder(records, truth, source=f"own {suite} {seed}", chosen=chosen)


def external(
    path: Path,
    out: Path,
    seed: int,
    first: int | Sequence[int] | None,
    jobs: int,
    names: Path | None,
) -> list[Case]:
    """Ask an external generator for fresh draws of its cases; those that are there are kept.

    It is a package `cases` with `n_cases()` and a program `generate --case N --seed S --out DIR`,
    as its own process: nothing of it is imported here. Case N has seed S + N.

    Args:
        path: Folder of the package.
        out: Folder for the records; the truth goes beside it.
        seed: Of the cases.
        first: Only so many, drawn at random, or the numbers of some; None: all.
        jobs: Processes.
        names: Table from its words to ids of the library.

    Raises:
        SourceError: It is absent, or does not run.
    """
    if not (path / "generate.py").is_file():
        raise SourceError(f"{path}: there is no generate.py in it")
    package, folder = path.resolve(), out / f"{path.name}-{seed}"

    def ask(*arguments: str) -> str:
        done = subprocess.run(
            [sys.executable, *arguments],
            cwd=package.parent,
            env={**os.environ, **ONE_THREAD},
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            last = (done.stderr.strip().splitlines() or ["no words"])[-1]
            raise SourceError(f"{path}: it does not run: {last}")
        return done.stdout

    count = int(ask("-c", f"from {package.name} import cases; print(cases.n_cases())"))
    numbers = list(range(count))
    if isinstance(first, int) and first < count:
        numbers = sorted(random.Random(seed).sample(numbers, first))
    elif isinstance(first, Sequence):
        numbers = list(first)

    def make(number: int) -> None:
        name = f"case_{number:03d}"
        if (out / f"{folder.name}_truth" / f"{name}.truth.json").exists():
            return
        told = ("--case", str(number), "--seed", str(seed + number), "--out", str(folder.resolve()))
        ask("-m", f"{package.name}.generate", *told)

    with ThreadPoolExecutor(jobs) as pool:
        for done, _ in enumerate(pool.map(make, numbers), 1):
            print(f"\r{done} of {len(numbers)} cases", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    chosen = [f"case_{number:03d}" for number in numbers]
    return read_folder(folder, source=f"{path.name} {seed}", names=names, chosen=chosen)
