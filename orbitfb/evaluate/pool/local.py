"""A pool of local processes that survives the death of any of them."""

import json
import os
import selectors
import subprocess
import sys
from collections import Counter, deque
from collections.abc import Iterator, Sequence

from orbitfb.evaluate.pool.task import Outcome, Task

ATTEMPTS = 3
"""A task that has killed so many workers is given up."""

_ONE_THREAD = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)
_PIECE = 1 << 16


def run_local(tasks: Sequence[Task], workers: int) -> Iterator[tuple[Task, Outcome]]:
    """Run tasks in processes of their own, one arithmetic thread each.

    A worker that dies is replaced, and its task is run again; no other task is touched.

    Args:
        tasks: What to run.
        workers: How many processes.

    Yields:
        Every task once, with what came of it, as it comes.
    """
    waiting, deaths = deque(tasks), Counter[str]()
    pool = [_Worker() for _ in range(min(workers, len(tasks)))]
    try:
        with selectors.DefaultSelector() as selector:
            for worker in pool:
                worker.begin(waiting.popleft())
                selector.register(worker.file, selectors.EVENT_READ, worker)
            while selector.get_map():
                for event, _ in selector.select():
                    worker: _Worker = event.data
                    task, outcome = worker.task, worker.take()
                    if outcome is None and not worker.dead:
                        continue
                    if outcome is None:
                        selector.unregister(worker.file)
                        end = worker.stop()
                        deaths[task.key] += 1
                        if deaths[task.key] < ATTEMPTS:
                            waiting.appendleft(task)
                        else:
                            yield task, Outcome(error=_given_up(end))
                        if waiting:
                            worker.start()
                            worker.begin(waiting.popleft())
                            selector.register(worker.file, selectors.EVENT_READ, worker)
                        continue
                    if waiting:
                        worker.begin(waiting.popleft())
                    else:
                        selector.unregister(worker.file)
                        worker.stop()
                    yield task, outcome
    finally:
        for worker in pool:
            worker.stop()


def cores() -> int:
    """Count the cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _given_up(end: int) -> str:
    how = f"signal {-end}" if end < 0 else f"exit status {end}"
    return (
        f"given up after it took {ATTEMPTS} worker processes down with it (the last by {how}); "
        "out of memory? Run it alone with one worker to see"
    )


class _Worker:
    """One process and its two pipes."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self.start()

    def start(self) -> None:
        """Start the process, again after `stop`."""
        self._process = subprocess.Popen(
            [sys.executable, "-m", "orbitfb.evaluate.pool.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **_ONE_THREAD},
            start_new_session=True,  # Ctrl-C reaches the parent alone
        )
        self._said, self.dead = b"", False
        self._send(json.dumps({"path": [path or os.getcwd() for path in sys.path]}))

    @property
    def file(self) -> int:
        """Descriptor of the answers."""
        if self._process is None or self._process.stdout is None:
            raise RuntimeError("a worker without a process was asked for its pipe")
        return self._process.stdout.fileno()

    def begin(self, task: Task) -> None:
        """Hand it a task."""
        self.task = task
        self._send(json.dumps({"function": task.function, "arguments": dict(task.arguments)}))

    def take(self) -> Outcome | None:
        """Read what there is; give the outcome when it is whole. Sets `dead` at the end."""
        piece = os.read(self.file, _PIECE)
        self.dead = not piece
        self._said += piece
        if not self._said.endswith(b"\n"):
            return None
        line, self._said = self._said, b""
        return Outcome.from_line(line)

    def stop(self) -> int:
        """End it and give its exit status: minus the signal that ended it."""
        process, self._process = self._process, None
        if process is None:
            return 0
        if not self.dead:
            process.kill()
        status = process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                try:
                    pipe.close()
                except BrokenPipeError:
                    continue  # a task that it never got to read
        return status

    def _send(self, text: str) -> None:
        if self._process is None or self._process.stdin is None:
            raise RuntimeError("a worker without a process was sent a task")
        try:
            self._process.stdin.write(text.encode() + b"\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            return  # it died; its answers end, and there it is counted
