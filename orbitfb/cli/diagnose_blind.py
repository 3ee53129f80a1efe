"""The command that checks the diagnosis on sealed cases: generate, diagnose, score.

Three kinds of processes that share nothing but files: a generator that knows no effect of the
library, `orbitfb diagnose` once per record, and a scorer that alone opens the truth.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

LONGEST = 600.0
"""Time after which a diagnosis counts as without an answer [s]."""


@dataclass(frozen=True)
class _Task:
    """One record to diagnose.

    Args:
        record: Its file.
        later: The later record, if there is one.
        out: Directory of the answer.
        rings: Options that name a ring of its own.
        without: Effect that the library is to lack; empty: none.
    """

    record: Path
    later: Path | None
    out: Path
    rings: tuple[str, ...]
    without: str


def diagnose_blind(
    suite: Annotated[
        str,
        typer.Option(help="quick: about 50 cases, fast: 230, full: 1700."),
    ] = "quick",
    seed: Annotated[int, typer.Option(min=0, help="Seed of the cases.")] = 1,
    jobs: Annotated[int, typer.Option(min=1, help="Diagnoses at the same time.")] = 2,
    out: Annotated[
        Path, typer.Option(help="Directory for records, truth, answers and the table.")
    ] = Path("orbitfb-data/blind"),
    leave_one_out: Annotated[
        bool,
        typer.Option(help="Diagnose clear cases once more with their effect left out."),
    ] = True,
    baselines: Annotated[bool, typer.Option(help="Score simpler methods beside it.")] = True,
) -> None:
    """Check the diagnosis on sealed cases; what is answered already is not done again."""
    from orbitfb.cli.options import make_out
    from orbitfb.core.errors import ConfigError

    source = source_checkout()
    if suite not in ("quick", "fast", "full"):
        raise ConfigError(f"--suite: there is no {suite!r}; choose quick, fast or full")
    make_out(out)
    data, truth, answers = out / "data", out / "truth", out / "answers"
    _module(
        source,
        "tests.blind.generate",
        *("--suite", suite, "--seed", str(seed), "--jobs", str(jobs)),
        *("--out", str(data), "--truth", str(truth)),
    )
    tasks = list(_tasks(data, answers))
    _all(tasks, jobs, "diagnosed")
    arguments = ["--truth", str(truth), "--answers", str(answers), "--rings", str(data)]
    if leave_one_out:
        chosen = _module(source, "tests.blind.leave_out", "--truth", str(truth), quiet=True)
        without = dict(line.split() for line in chosen.splitlines())
        _all(list(_tasks(data, out / "without", without)), jobs, "diagnosed without their effect")
        arguments += ["--without", str(out / "without")]
    if baselines:
        given = ("--data", str(data), "--out", str(out / "baselines"), "--jobs", str(jobs))
        for name in _module(source, "tests.blind.baselines", *given, quiet=True).split():
            arguments += ["--baseline", f"{name}={out / 'baselines' / name}"]
    arguments += ["--out", str(out / "result.json")]
    print(_module(source, "tests.blind.score", *arguments, quiet=True), end="")
    print(f"written: {out / 'result.json'} and {out / 'result.md'}")


def source_checkout() -> Path:
    """Find the checkout that this package runs from; the generator is not part of the package.

    Raises:
        ConfigError: There is none.
    """
    import orbitfb
    from orbitfb.core.errors import ConfigError

    root = Path(orbitfb.__file__).resolve().parents[1]
    if not (root / "tests" / "blind" / "generate.py").is_file():
        raise ConfigError(
            "the generator of sealed cases is not part of the installed package; run this from a "
            "checkout of the source (tests/blind), installed with `pip install --editable`"
        )
    return root


def _tasks(data: Path, answers: Path, without: dict[str, str] | None = None) -> Iterator[_Task]:
    """List the records that still lack an answer."""
    second = data / "second-ring.csv"
    for record in sorted((data / "records").glob("*.npz")):
        name = record.stem
        target = answers / name
        if (without is not None and name not in without) or _answered(target):
            continue
        later = data / "later" / record.name
        rings: tuple[str, ...] = ()
        if second.exists() and _on_ring(record, second):
            rings = ("--places", str(second), "--ring", str(second.with_suffix(".json")))
        yield _Task(
            record=record,
            later=later if later.exists() else None,
            out=target,
            rings=rings,
            without="" if without is None else without[name],
        )


def _answered(target: Path) -> bool:
    """Tell whether a record was diagnosed already; one that failed is tried again."""
    told = target / "run.json"
    return told.exists() and json.loads(told.read_text(encoding="utf-8"))["exit"] in (0, 3)


def _on_ring(record: Path, places: Path) -> bool:
    """Tell whether the devices of a record are of a table of places."""
    import numpy as np

    with np.load(record, allow_pickle=False) as arrays:
        name = str(arrays["bpm_names"][0])
    return f"\n{name}," in places.read_text(encoding="utf-8")


def _all(tasks: Sequence[_Task], jobs: int, what: str) -> None:
    with ThreadPoolExecutor(jobs) as pool:
        for count, _ in enumerate(pool.map(_diagnose, tasks), 1):
            print(f"\r{count} of {len(tasks)} {what}", end="", file=sys.stderr, flush=True)
    if tasks:
        print(file=sys.stderr)


def _diagnose(task: _Task) -> None:
    """Run one diagnosis in a process of its own; how it ended is kept beside its answer."""
    task.out.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "orbitfb", "diagnose", "record", str(task.record)]
    command += ["--out", str(task.out), "--json", *task.rings]
    if task.later is not None:
        command += ["--holdout", str(task.later)]
    if task.without:
        command += ["--without", task.without]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    start = time.monotonic()
    try:
        ended = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=LONGEST, check=False
        )
        code, said = ended.returncode, ended.stderr[-4000:]
    except subprocess.TimeoutExpired:
        code, said = -1, f"no answer within {LONGEST:g} s"
    told = {"exit": code, "seconds": round(time.monotonic() - start, 3), "stderr": said}
    (task.out / "run.json").write_text(json.dumps(told, indent=1), encoding="utf-8")


def _module(source: Path, module: str, *arguments: str, quiet: bool = False) -> str:
    """Run a module of the checkout as a process of its own; give what it prints.

    Raises:
        ConfigError: It failed; its last words are in the message.
    """
    from orbitfb.core.errors import ConfigError

    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    environment["PYTHONPATH"] = os.pathsep.join(
        [str(source), *filter(None, [os.environ.get("PYTHONPATH")])]
    )
    ended = subprocess.run(
        [sys.executable, "-m", module, *arguments],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=None,
        text=True,
        check=False,
    )
    if ended.returncode:
        raise ConfigError(f"python -m {module} ended with {ended.returncode}: see its words above")
    if not quiet:
        print(ended.stdout, end="")
    return ended.stdout
