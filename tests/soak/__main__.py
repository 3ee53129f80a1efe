"""`python -m tests.soak`: hours simulated, then minutes over Channel Access; 1 if not flat."""

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path

MEMORY = 16.0
"""Growth of the memory that is none [MB]."""


def main() -> int:
    """Soak as told on the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.soak", description=__doc__)
    parser.add_argument("--hours", type=float, default=12.0, help="simulated time [h]; 0: none")
    parser.add_argument("--minutes", type=float, default=30.0, help="over CA [min]; 0: none")
    parser.add_argument("--rate", type=float, default=10.0, help="of the loop over CA [Hz]")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="file for the figures (JSON)")
    arguments = parser.parse_args()
    if min(arguments.hours, arguments.minutes, arguments.seed) < 0:
        parser.error("--hours, --minutes and --seed must not be negative")
    if not 1 <= arguments.rate <= 200:
        parser.error("--rate must be between 1 and 200 Hz")
    from tests.chaos.__main__ import prepare

    prepare()
    from tests.soak.over_ca import over_ca
    from tests.soak.simulated import simulate

    began = time.monotonic()

    def say(line: str) -> None:
        print(f"{time.monotonic() - began:7.1f} s  {line}", flush=True)

    soaks = []
    with tempfile.TemporaryDirectory(prefix="orbitfb-soak-") as temporary:
        os.environ["XDG_RUNTIME_DIR"] = temporary
        directory = Path(temporary)
        if arguments.hours:
            soaks.append(simulate(arguments.hours, directory / "archive", arguments.seed, say))
        if arguments.minutes:
            soaks.append(over_ca(arguments.minutes, directory, arguments.rate, say))
    problems = [problem for soak in soaks for problem in soak.problems(MEMORY)]
    for soak in soaks:
        print("\n".join(soak.lines()) + f"\n  {soak.notes}")
    print("not flat:\n  " + "\n  ".join(problems) if problems else "flat")
    if arguments.out is not None:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        result = {"problems": problems, "soaks": [soak.row() for soak in soaks]}
        arguments.out.write_text(json.dumps(result, indent=1) + "\n")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
