"""Write a suite of sealed cases: records here, truth there.

    python -m benchmarks.blind.generator.generate --suite quick --seed 1 --out DIR --truth DIR

Names of cases tell nothing; the records come in shuffled order with the same arrays, and the
truth is hashed before anybody looks at a record.
"""

import argparse
import hashlib
import json
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind.generator.cases import Spec, make
from benchmarks.blind.generator.suites import Suite, plan


def opaque(seed: int, index: int) -> str:
    """Name of a case that tells neither its place in the suite nor its effect."""
    return hashlib.sha256(f"blind case {seed} {index}".encode()).hexdigest()[:12]


def write_case(spec: Spec, name: str, out: Path, truth: Path, suite_seed: int) -> str:
    """Make a case and write its files; leave one that is there already."""
    truth_file = truth / f"{name}.json"
    if truth_file.exists() and (out / f"{name}.npz").exists():
        return name
    case = make(spec, out, suite_seed)
    save(out / f"{name}.npz", case.record)
    if case.later is not None:
        save(out / "later" / f"{name}.npz", case.later)
    for file in (out / f"{name}.npz", out / "later" / f"{name}.npz"):
        if file.exists():
            os.utime(file, (1.7e9, 1.7e9))
    document = {"case": name, "later": case.later is not None, **case.truth}
    truth_file.write_text(json.dumps(document, indent=1), encoding="utf-8")
    return name


def save(file: Path, arrays: dict[str, NDArray[Any]]) -> None:
    """Write a record."""
    np.savez_compressed(file, allow_pickle=False, **arrays)


def seal(out: Path, truth: Path, suite: str, seed: int) -> str:
    """Hash truth and records; write both manifests; give the hash of the truth."""
    hashes = {f.name: _sha256(f) for f in sorted(truth.glob("*.json")) if f.name != "manifest.json"}
    whole = hashlib.sha256(json.dumps(hashes, sort_keys=True).encode()).hexdigest()
    own: dict[str, Any] = {"suite": suite, "seed": seed, "sha256": whole, "files": hashes}
    (truth / "manifest.json").write_text(json.dumps(own, indent=1), encoding="utf-8")
    records = {f.name: _sha256(f) for f in sorted(out.glob("*.npz"))}
    public = {"suite": suite, "seed": seed, "truth_sha256": whole, "records": records}
    (out / "manifest.json").write_text(json.dumps(public, indent=1), encoding="utf-8")
    return whole


def _sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def generate(
    suite: Suite,
    seed: int,
    out: Path,
    truth: Path,
    jobs: int,
    only: str = "",
    first: int | None = None,
) -> list[str]:
    """Write a suite, or the first cases of its random order; give the names of the cases."""
    for folder in (out, out / "later", truth):
        folder.mkdir(parents=True, exist_ok=True)
    specs = [s for s in plan(suite, seed) if not only or only in s.effects]
    order = np.random.default_rng([seed, 9]).permutation(len(specs))[:first]
    tasks = [(specs[i], opaque(seed, int(i)), out, truth, seed) for i in order]
    with ProcessPoolExecutor(jobs) as pool:
        for count, _ in enumerate(pool.map(write_case, *zip(*tasks, strict=True)), 1):
            print(f"\r{count} of {len(tasks)} cases", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    seal(out, truth, suite, seed)
    return [name for _, name, *_ in tasks]


def main() -> None:
    """Take the command line."""
    parser = argparse.ArgumentParser(description="Write a suite of sealed cases.")
    parser.add_argument("--suite", choices=get_args(Suite), default="quick")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True, help="for the records, and later/")
    parser.add_argument("--truth", type=Path, required=True, help="not within --out")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--first", type=int, help="only so many, drawn at random")
    parser.add_argument("--only", default="", help="cases of one effect only")
    options = parser.parse_args()
    if options.truth.resolve().is_relative_to(options.out.resolve()):
        parser.error("--truth lies among the records")
    names = generate(
        options.suite,
        options.seed,
        options.out,
        options.truth,
        options.jobs,
        options.only,
        options.first,
    )
    print(f"{len(names)} cases in {options.out}, sealed by {options.truth / 'manifest.json'}")


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    main()
