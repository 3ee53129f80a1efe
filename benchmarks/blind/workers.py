"""Processes that diagnose records: each on one core, each ended when it takes too long."""

import json
import math
import multiprocessing
import os
import resource
import signal
import sys
import time
import traceback
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from benchmarks.blind.engines import ask, load
from benchmarks.measure import cpu_time

ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
"""Environment of processes that compute on one core each."""
LONGEST = 600.0
"""Processor time after which a record counts as without an answer [s]."""
PATIENCE = 30.0
"""Wall clock that a process may take, over its processor time: on a busy computer it waits."""
_TICK = 0.5
"""How often to look whether a record takes too long [s]."""


@dataclass(frozen=True, slots=True)
class Task:
    """A record to be diagnosed.

    Args:
        engine: As `module:function`.
        record: Its file.
        later: A later record, if there is one.
        ring: Table of places and parameters of its ring, if it is not the packaged one.
        without: Ids that the library is to lack.
        keep: Where the answer is kept.
        state: Of the engine's code; an answer of another state is asked for again.
    """

    engine: str
    record: Path
    later: Path | None
    ring: tuple[Path, Path] | None
    without: tuple[str, ...]
    keep: Path
    state: str


@dataclass(frozen=True, slots=True)
class Answer:
    """What an engine said.

    Args:
        diagnosis: In the form of `diagnosis.json`; None: no answer.
        seconds: Wall clock [s].
        cpu: Processor time [s].
        peak_mb: Largest memory of its process so far [MB].
        problem: Last words, if there is no answer.
    """

    diagnosis: dict[str, Any] | None
    seconds: float
    cpu: float = math.nan
    peak_mb: float = math.nan
    problem: str = ""


@dataclass(slots=True)
class _Worker:
    """A process, the task that it has, and since when."""

    process: BaseProcess
    pipe: Connection
    task: Task | None = None
    since: float = 0.0
    used: float = 0.0


def diagnose_all(tasks: Sequence[Task], jobs: int, longest: float = LONGEST) -> list[Answer]:
    """Diagnose records, some at the same time; answers of the same code are not asked for again.

    Args:
        tasks: What is to be done.
        jobs: Processes.
        longest: Processor time that a record may take [s].
    """
    kept = {task.keep: found for task in tasks if (found := _kept(task)) is not None}
    todo = [task for task in tasks if task.keep not in kept]
    if kept:
        print(f"{len(kept)} answers of the same code are there already", file=sys.stderr)
    done = 0

    def finish(task: Task, answer: Answer) -> None:
        nonlocal done
        done += 1
        kept[task.keep] = answer
        _keep(task, answer)
        print(f"\r{done} of {len(todo)} diagnosed", end="", file=sys.stderr, flush=True)

    with ended_with_us():
        _work(todo, jobs, longest, finish)
    if todo:
        print(file=sys.stderr)
    return [kept[task.keep] for task in tasks]


def _work(
    todo: Sequence[Task], jobs: int, longest: float, finish: Callable[[Task, Answer], None]
) -> None:
    left = list(reversed(todo))
    workers: list[_Worker] = []
    try:
        while left or any(one.task for one in workers):
            while left and len(workers) < jobs:
                workers.append(_start())
            for one in workers:
                if one.task is None and left:
                    one.task = left.pop()
                    _begin(one)
                    one.pipe.send(one.task)
            wait([one.pipe for one in workers if one.task], _TICK)
            for one in tuple(workers):
                answer = _heard(one, longest)
                if answer is None or one.task is None:
                    continue
                finish(one.task, answer)
                one.task = None
                if not one.process.is_alive():
                    workers.remove(one)
    finally:
        for one in workers:
            _end(one)


def _heard(one: _Worker, longest: float) -> Answer | None:
    """Hear what came of a task; None: nothing yet."""
    if one.task is None:
        return None
    seconds = time.monotonic() - one.since
    if one.pipe.poll():
        try:
            said: Answer | None = one.pipe.recv()
        except (EOFError, ConnectionError):  # it may die before it takes its task
            one.process.join()
            return Answer(None, seconds, problem=f"its process ended: {one.process.exitcode}")
        if said is None:  # it has the engine now, and begins
            _begin(one)
        return said
    used = _cpu(one) - one.used
    if used > longest or seconds > PATIENCE * longest:
        _end(one)
        problem = f"no answer within {longest:g} s of processor time"
        return Answer(None, seconds, used, problem=problem)
    return None


def _begin(one: _Worker) -> None:
    one.since, one.used = time.monotonic(), _cpu(one)


def _cpu(one: _Worker) -> float:
    """Give the processor time that a process has used [s]; 0: it has ended."""
    try:
        return cpu_time(one.process.pid or 0)
    except OSError:
        return 0.0


def _start() -> _Worker:
    """Start a process; its libraries read the number of threads when they are loaded."""
    os.environ.update(ONE_THREAD)
    context = multiprocessing.get_context("spawn")
    ours, its = context.Pipe()
    process = context.Process(target=_serve, args=(its,), daemon=True)
    process.start()
    its.close()
    return _Worker(process, ours)


def _end(one: _Worker) -> None:
    one.process.kill()
    one.process.join()
    one.pipe.close()


def _serve(pipe: Connection) -> None:
    """Answer tasks until nobody asks any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
        try:
            task: Task = pipe.recv()
        except EOFError:
            return
        try:
            pipe.send(_answered(task, lambda: pipe.send(None)))
        except BrokenPipeError:
            return


def _used() -> float:
    """Processor time of this process and of those that it has waited for [s]."""
    return sum(os.times()[:4])


def _answered(task: Task, begin: Callable[[], None]) -> Answer:
    start, used = time.monotonic(), _used()
    said, problem = None, ""
    try:
        engine = load(task.engine)
        begin()
        start, used = time.monotonic(), _used()
        said = ask(engine, task.record, later=task.later, ring=task.ring, without=task.without)
    except Exception:  # whatever an engine dies of is its answer
        problem = traceback.format_exc()[-2000:]
    return Answer(
        said,
        round(time.monotonic() - start, 3),
        round(_used() - used, 3),
        round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1),
        problem,
    )


def _kept(task: Task) -> Answer | None:
    """Read an answer of the same code to the same record; what failed is tried again."""
    try:
        told = json.loads(task.keep.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if told.get("state") != task.state or told.get("record") != str(task.record.resolve()):
        return None
    found = Answer(**told["answer"])
    return None if found.diagnosis is None else found


def _keep(task: Task, answer: Answer) -> None:
    task.keep.parent.mkdir(parents=True, exist_ok=True)
    told = {name: getattr(answer, name) for name in Answer.__dataclass_fields__}
    document = {"state": task.state, "record": str(task.record.resolve()), "answer": told}
    task.keep.write_text(json.dumps(document), encoding="utf-8")


@contextmanager
def ended_with_us() -> Generator[None, None, None]:
    """Turn a request to end into an exit, so that no process outlives this one."""

    def asked(number: int, frame: object) -> None:
        raise SystemExit(128 + number)

    before = signal.signal(signal.SIGTERM, asked)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
