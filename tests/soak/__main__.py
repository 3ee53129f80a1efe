"""`python -m tests.soak`: hours and days simulated, then minutes over Channel Access.

The exit code is 1 if something is not flat, or the energy of the beam does not stay in the days.
"""

import argparse
import json
import os
import signal
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

MEMORY = 16.0
"""Growth of the memory that is none [MB]."""


def main() -> int:
    """Soak as told on the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.soak", description=__doc__)
    parser.add_argument("--hours", type=float, default=12.0, help="simulated time [h]; 0: none")
    parser.add_argument(
        "--days", type=float, default=7.0, help="simulated with tide, gaps, temperature; 0: none"
    )
    parser.add_argument("--days-rate", type=float, default=1.0, help="of the loop in them [Hz]")
    parser.add_argument("--minutes", type=float, default=30.0, help="over CA [min]; 0: none")
    parser.add_argument("--rate", type=float, default=10.0, help="of the loop over CA [Hz]")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="file for the figures (JSON)")
    arguments = parser.parse_args()
    if min(arguments.hours, arguments.days, arguments.minutes, arguments.seed) < 0:
        parser.error("--hours, --days, --minutes and --seed must not be negative")
    if not 1 <= arguments.rate <= 200 or not 0.5 <= arguments.days_rate <= 200:
        parser.error("--rate must be between 1 and 200 Hz, --days-rate between 0.5 and 200 Hz")
    from tests.chaos.__main__ import prepare

    prepare()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that no process is left behind
    from tests.soak.days import live
    from tests.soak.over_ca import over_ca
    from tests.soak.simulated import simulate

    began = time.monotonic()

    def say(line: str) -> None:
        print(f"{time.monotonic() - began:7.1f} s  {line}", flush=True)

    soaks, energies = [], []
    with tempfile.TemporaryDirectory(prefix="orbitfb-soak-") as temporary:
        os.environ["XDG_RUNTIME_DIR"] = temporary
        directory = Path(temporary)
        if arguments.hours:
            soaks.append(simulate(arguments.hours, directory / "archive", arguments.seed, say))
        if arguments.days:
            soak, energy = live(arguments.days, arguments.seed, arguments.days_rate, say=say)
            soaks.append(soak)
            energies.append(energy)
        if arguments.minutes:
            soaks.append(over_ca(arguments.minutes, directory, arguments.rate, say))
    problems = [problem for soak in soaks for problem in soak.problems(MEMORY)]
    problems += [problem for energy in energies for problem in energy.problems()]
    for soak in soaks:
        print("\n".join(soak.lines()) + f"\n  {soak.notes}")
    for energy in energies:
        print("\n".join(energy.lines()))
    print("not flat:\n  " + "\n  ".join(problems) if problems else "flat")
    if arguments.out is not None:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        result = {
            "problems": problems,
            "soaks": [soak.row() for soak in soaks],
            "energy": [asdict(energy) for energy in energies],
        }
        arguments.out.write_text(json.dumps(result, indent=1) + "\n")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
