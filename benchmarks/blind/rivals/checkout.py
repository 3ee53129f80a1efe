"""The diagnosis of another checkout of this repository: of an earlier commit, or of a branch.

    git worktree add ../before COMMIT
    ORBITFB_CHECKOUT=../before python -m benchmarks.blind --own 57 \
        --engine benchmarks.blind.engines:installed \
        --engine benchmarks.blind.rivals.checkout:diagnose

It runs in a process of its own with the packages of this environment, which counts as processor
time of the record.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.blind.engines import EngineError

VARIABLE = "ORBITFB_CHECKOUT"
"""Of the environment: the folder of the checkout."""

_ASK = """
import json, sys
from pathlib import Path
from benchmarks.blind.engines import installed
out, record, later, ring, without = json.loads(sys.argv[1])
told = {
    "later": later and Path(later),
    "ring": ring and tuple(map(Path, ring)),
    "without": tuple(without),
}
Path(out).write_text(json.dumps(installed(Path(record), **told)), encoding="utf-8")
"""


def diagnose(
    record: Path,
    *,
    later: Path | None = None,
    ring: tuple[Path, Path] | None = None,
    without: tuple[str, ...] = (),
) -> dict[str, Any]:
    """Diagnose a record as the other checkout does.

    Raises:
        EngineError: There is no such checkout, or it gives no answer.
    """
    given = os.environ.get(VARIABLE, "")
    checkout = Path(given)
    if not given or not (checkout / "benchmarks/blind/engines.py").exists():
        raise EngineError(
            f"{VARIABLE} is {given or 'not set'}: give the folder of a checkout that has "
            "benchmarks/blind/engines.py"
        )
    with TemporaryDirectory() as folder:
        out = Path(folder) / "answer.json"
        told = [
            str(out),
            str(record.resolve()),
            str(later.resolve()) if later else None,
            [str(one.resolve()) for one in ring] if ring else None,
            list(without),
        ]
        done = subprocess.run(
            [sys.executable, "-c", _ASK, json.dumps(told)],
            cwd=checkout,
            env={**os.environ, "PYTHONPATH": str(checkout.resolve())},
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            last = (done.stderr.strip().splitlines() or ["no words"])[-1]
            raise EngineError(f"{checkout}: it gives no answer to {record}: {last}")
        return json.loads(out.read_text(encoding="utf-8"))
