"""A local worker: lines of JSON in, lines of JSON out, until the parent is gone.

The first line gives the import path, each further one a task.
"""

import json
import os
import queue
import sys
import threading
from typing import Any

from orbitfb.evaluate.pool.task import execute


def main() -> None:
    """Serve tasks; end at once when the pipe to the parent closes, in the middle of a task too."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a task prints must not get among the answers
    tasks: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    sys.path[:] = json.loads(sys.stdin.buffer.readline())["path"]
    threading.Thread(target=_listen, args=(tasks,), daemon=True).start()
    while True:
        task = tasks.get()
        outcome = execute(task["function"], task["arguments"])
        try:
            answers.write(outcome.to_line())
            answers.flush()
        except BrokenPipeError:
            return


def _listen(tasks: "queue.SimpleQueue[dict[str, Any]]") -> None:
    for line in sys.stdin.buffer:
        tasks.put(json.loads(line))
    os._exit(0)


if __name__ == "__main__":
    main()
