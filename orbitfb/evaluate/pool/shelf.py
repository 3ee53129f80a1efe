"""Where the results of a campaign lie: two files for each task, published at once or not at all."""

import json
import os
from pathlib import Path

from orbitfb.core.errors import RecordError
from orbitfb.core.files.bounded import parse_json, read_bytes
from orbitfb.evaluate.pool.task import Outcome, Task, source

_LARGEST = 2**30
_ADVICE = "remove it to run the task again"


class Shelf:
    """Results by the key of their task, in a directory.

    `KEY.npz` holds the arrays, `KEY.json` all the rest and what was asked for. The JSON file
    comes last: when it is there, the result is whole.

    Args:
        directory: Where; made when it is not there.
    """

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        directory.mkdir(parents=True, exist_ok=True)

    def find(self, task: Task) -> Outcome | None:
        """Give a result that was published before; None if there is none that can be read."""
        path = self._directory / f"{task.key}.json"
        try:
            text = read_bytes(path, _LARGEST, RecordError, _ADVICE)
            document = parse_json(text, path, RecordError)
            packed = path.with_suffix(".npz")
            arrays = (
                read_bytes(packed, _LARGEST, RecordError, _ADVICE) if document["arrays"] else b""
            )
        except (RecordError, KeyError, TypeError):
            return None  # not there, or damaged from outside: then it is run again
        return Outcome(text=json.dumps(document["result"]), arrays=arrays)

    def publish(self, task: Task, outcome: Outcome) -> None:
        """Put a result there; whatever happens, nobody sees half of it."""
        if outcome.arrays:
            self._write(f"{task.key}.npz", outcome.arrays)
        document = {
            "function": task.function,
            "arguments": dict(task.arguments),
            "source": source(task.function),
            "arrays": bool(outcome.arrays),
            "result": json.loads(outcome.text),
        }
        self._write(f"{task.key}.json", json.dumps(document, indent=1).encode())

    def _write(self, name: str, content: bytes) -> None:
        new = self._directory / f".{name}.{os.getpid()}"
        with new.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        new.replace(self._directory / name)
