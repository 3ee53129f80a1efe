"""The processes of the check on sealed cases: one per diagnosis, and modules of the checkout."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")

LONGEST = 600.0
"""Time after which a diagnosis counts as without an answer [s]."""
_ASKED_TO_END = 128 + signal.SIGTERM
"""Exit code of a command that was ended by a signal."""
_running: set[subprocess.Popen[str]] = set()


@dataclass(frozen=True)
class Task:
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


@dataclass(frozen=True)
class Ended:
    """How a command ended.

    Args:
        code: Its exit code; −1: it took too long.
        seconds: That it took.
        stdout: What it told.
        stderr: Its last words.
    """

    code: int
    seconds: float
    stdout: str
    stderr: str

    def keep(self, file: Path, **more: Any) -> None:
        """Write this, and what else is to be known, as JSON."""
        told = {"exit": self.code, "seconds": self.seconds, "stderr": self.stderr, **more}
        file.write_text(json.dumps(told, indent=1), encoding="utf-8")


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


def claim(out: Path, suite: str, seed: int) -> None:
    """See that a directory is of this suite and seed, and mark a new one as theirs.

    Args:
        out: Of records, truth and answers.
        suite: Name of the suite.
        seed: Of its cases.

    Raises:
        ConfigError: It holds the cases of another suite or seed, which would be scored with these.
    """
    from orbitfb.core.errors import ConfigError

    mark, wanted = out / "suite.json", {"suite": suite, "seed": seed}
    for file in (mark, out / "truth" / "manifest.json"):
        if not file.exists():
            continue
        try:
            told = json.loads(file.read_text(encoding="utf-8"))
            there = {key: told[key] for key in wanted}
        except (ValueError, KeyError, TypeError) as error:
            raise ConfigError(f"--out {out}: {file} is damaged; use another --out") from error
        if there != wanted:
            raise ConfigError(
                f"--out {out}: it holds the cases of --suite {there['suite']} --seed "
                f"{there['seed']}, and not of {suite} and {seed}; use another --out, or go on "
                "with that suite and seed"
            )
    mark.write_text(json.dumps(wanted), encoding="utf-8")


def tasks(data: Path, answers: Path, without: dict[str, str] | None = None) -> Iterator[Task]:
    """List the records that still lack an answer.

    Args:
        data: With `records/`, and `later/` where there is more.
        answers: A directory for each record.
        without: Effect that the library is to lack, by record; only these records then.
    """
    for record in sorted((data / "records").glob("*.npz")):
        name = record.stem
        target = answers / name
        if (without is not None and name not in without) or answered(target / "run.json"):
            continue
        later = data / "later" / record.name
        yield Task(
            record=record,
            later=later if later.exists() else None,
            out=target,
            rings=rings_of(record, data),
            without="" if without is None else without[name],
        )


def answered(told: Path) -> bool:
    """Tell whether a command has ended well already; one that failed is tried again."""
    return told.exists() and json.loads(told.read_text(encoding="utf-8"))["exit"] in (0, 3)


def rings_of(record: Path, data: Path) -> tuple[str, ...]:
    """Give the options that name the ring of a record, if it is not the usual one."""
    import numpy as np

    places = data / "second-ring.csv"
    if not places.exists():
        return ()
    with np.load(record, allow_pickle=False) as arrays:
        name = str(arrays["bpm_names"][0])
    if f"\n{name}," not in places.read_text(encoding="utf-8"):
        return ()
    return ("--places", str(places), "--ring", str(places.with_suffix(".json")))


def diagnose_all(todo: Sequence[Task], jobs: int, what: str) -> None:
    """Diagnose records, some at the same time."""
    each(_diagnose, todo, jobs, what)


@contextmanager
def outliving_none() -> Iterator[None]:
    """Let no process that was started here outlive this one, asked to end or not."""

    def ask(number: int, frame: object) -> None:
        raise SystemExit(_ASKED_TO_END)

    before = signal.signal(signal.SIGTERM, ask)
    try:
        yield
    finally:
        _end_all()
        signal.signal(signal.SIGTERM, before)


def each(work: Callable[[T], None], todo: Sequence[T], jobs: int, what: str) -> None:
    """Do some things at the same time, and count them on the screen."""
    with ThreadPoolExecutor(jobs) as pool:
        try:
            for count, _ in enumerate(pool.map(work, todo), 1):
                print(f"\r{count} of {len(todo)} {what}", end="", file=sys.stderr, flush=True)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            _end_all()  # else the threads wait for them
            raise
    if todo:
        print(file=sys.stderr)


def _end_all() -> None:
    """Ask the processes that run to end, and all that they started."""
    for process in tuple(_running):
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGTERM)


def _run(
    arguments: Sequence[str],
    environment: dict[str, str],
    *,
    errors: int | None,
    longest: float | None = None,
) -> subprocess.CompletedProcess[str]:
    """Run a process to its end, in a group of its own: what it starts can be ended with it.

    Raises:
        subprocess.TimeoutExpired: It took longer [s].
    """
    with subprocess.Popen(
        [sys.executable, "-m", *arguments],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=errors,
        text=True,
        start_new_session=True,
    ) as process:
        _running.add(process)
        try:
            told, said = process.communicate(timeout=longest)
        finally:
            _running.discard(process)
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGTERM)
    return subprocess.CompletedProcess(process.args, process.returncode, told, said)


def command(*arguments: str, module: str = "orbitfb") -> Ended:
    """Run `orbitfb`, or another module, in a process of its own, on one core."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    start = time.monotonic()
    try:
        ended = _run((module, *arguments), environment, errors=subprocess.PIPE, longest=LONGEST)
        code, told, said = ended.returncode, ended.stdout, ended.stderr[-4000:]
    except subprocess.TimeoutExpired:
        code, told, said = -1, "", f"no answer within {LONGEST:g} s"
    return Ended(code, round(time.monotonic() - start, 3), told, said)


def _diagnose(task: Task) -> None:
    """Run one diagnosis; how it ended is kept beside its answer."""
    task.out.mkdir(parents=True, exist_ok=True)
    arguments = ["diagnose", "record", str(task.record), "--out", str(task.out), "--json"]
    arguments += task.rings
    if task.later is not None:
        arguments += ["--holdout", str(task.later)]
    if task.without:
        arguments += ["--without", task.without]
    command(*arguments).keep(task.out / "run.json")


def module(source: Path, name: str, *arguments: str, quiet: bool = False) -> str:
    """Run a module of the checkout as a process of its own; give what it prints.

    Raises:
        ConfigError: It failed; its last words are in the message.
    """
    from orbitfb.core.errors import ConfigError

    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    environment["PYTHONPATH"] = os.pathsep.join(
        [str(source), *filter(None, [os.environ.get("PYTHONPATH")])]
    )
    ended = _run((name, *arguments), environment, errors=None)
    if ended.returncode:
        raise ConfigError(f"python -m {name} ended with {ended.returncode}: see its words above")
    if not quiet:
        print(ended.stdout, end="")
    return ended.stdout
