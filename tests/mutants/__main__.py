"""python -m tests.mutants [WORD ...]: break the rules of safety, and see whether a test notices.

Each rule of `tests/mutants/rules.py`, or each whose sentence has one of the words, is broken in a
copy of the package, one at a time, and its unit tests run there. A rule that no test notices is
named, and the command ends with 1. It takes about three seconds of computing for each rule.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue

from tests.mutants.rules import MUTANTS, ROOT, Mutant

COPIED = ("orbitfb", "tests")
LINKED = ("pyproject.toml", "docs", "deploy", "benchmarks", "README.md")
PASSED, FAILED = 0, 1
"""Exit codes of pytest; any other: it could not run the tests."""


def copy(place: Path) -> Path:
    """Copy what the tests need to a directory; give it."""
    for name in COPIED:
        shutil.copytree(ROOT / name, place / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in LINKED:
        (place / name).symlink_to(ROOT / name)
    return place


def run(place: Path, tests: Sequence[str]) -> subprocess.CompletedProcess[str]:
    """Run test files in a copy, up to the first failure."""
    options = ("-x", "-q", "--tb=line", "-p", "no:cacheprovider", "-n", "0")
    return subprocess.run(
        [sys.executable, "-B", "-m", "pytest", *options, *tests],
        cwd=place,
        env={**os.environ, "PYTHONPATH": str(place)},
        capture_output=True,
        text=True,
        check=False,
    )


def trouble(mutant: Mutant, place: Path) -> str:
    """Break a rule in a copy; say what is wrong with its tests, empty if they notice it."""
    file = place / mutant.file
    whole = file.read_text(encoding="utf-8")
    try:
        file.write_text(mutant.broken(whole), encoding="utf-8")
        done = run(place, mutant.paths)
    except ValueError as error:
        return str(error)
    finally:
        file.write_text(whole, encoding="utf-8")
    if done.returncode == FAILED:
        return ""
    if done.returncode == PASSED:
        return f"NOT NOTICED: {mutant.rule} ({mutant.file}; {', '.join(mutant.tests)} pass)"
    return f"{mutant.rule}: the tests do not run\n{done.stdout[-2000:]}{done.stderr[-2000:]}"


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("words", nargs="*", help="break only rules with one of these words")
    parser.add_argument("--jobs", type=int, default=2, help="rules at once")
    given = parser.parse_args()
    words: list[str] = given.words
    chosen = [m for m in MUTANTS if not words or any(word in m.rule for word in words)]
    begin = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="orbitfb-mutants-") as directory:
        places: SimpleQueue[Path] = SimpleQueue()
        for job in range(given.jobs):
            places.put(copy(Path(directory) / str(job)))

        def look(mutant: Mutant) -> str:
            place = places.get()
            try:
                return trouble(mutant, place)
            finally:
                places.put(place)

        whole = run(Path(directory) / "0", sorted({path for m in chosen for path in m.paths}))
        if whole.returncode != PASSED:
            print(f"the tests fail before anything is broken\n{whole.stdout[-4000:]}")
            return 1
        bad = 0
        with ThreadPoolExecutor(given.jobs) as pool:
            for mutant, found in zip(chosen, pool.map(look, chosen), strict=True):
                print(found or f"noticed: {mutant.rule}", flush=True)
                bad += bool(found)
    print(f"{len(chosen) - bad} of {len(chosen)} noticed, {time.monotonic() - begin:.0f} s")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
