"""`python -m tests.chaos`: run a campaign, print the counts, end with 1 if a rule was broken."""

import argparse
import os
import signal
import sys
import tempfile
import time
from pathlib import Path

from tests.chaos.kinds import KINDS
from tests.chaos.report import verdict, write


def main() -> int:
    """Run it as told on the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.chaos", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--faults", type=int, default=500)
    parser.add_argument("--rate", type=float, default=50.0, help="orbits per second [Hz]")
    parser.add_argument("--out", type=Path, help="directory for chaos.json and chaos.md")
    parser.add_argument("--keep", type=Path, help="directory for data and journals, kept")
    parser.add_argument("--alone", action="store_true", help="leave the plain loop out")
    parser.add_argument("--first", type=int, default=0, help="number of the episode to begin with")
    parser.add_argument("--kinds", default="", help="words, by commas: only kinds that have one")
    arguments = parser.parse_args()
    if arguments.faults < 1 or arguments.seed < 0 or not 10 <= arguments.rate <= 200:
        parser.error("--faults must be at least 1, --seed 0, --rate between 10 and 200 Hz")
    words = [word.strip() for word in arguments.kinds.split(",")]
    kinds = [kind for kind in KINDS if any(word in kind.name for word in words)]
    if all(kind.early for kind in kinds):
        names = ", ".join(kind.name for kind in KINDS if not kind.early)
        parser.error(f"--kinds {arguments.kinds!r} names none of: {names}")
    prepare()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that no process is left behind
    from tests.chaos.once import run_once

    with tempfile.TemporaryDirectory(prefix="orbitfb-chaos-") as temporary:
        os.environ["XDG_RUNTIME_DIR"] = temporary
        directory = arguments.keep or Path(temporary) / "campaign"
        if directory.exists() and any(directory.iterdir()):
            parser.error(f"{directory} is not empty; name another with --keep")
        began = time.monotonic()
        result = run_once(
            directory,
            arguments.seed,
            arguments.faults,
            arguments.rate,
            beside=not arguments.alone,
            say=lambda line: print(f"{time.monotonic() - began:7.1f} s  {line}", flush=True),
            first=arguments.first,
            kinds=kinds,
        )
    print("\n" + write(result, arguments.out))
    return verdict(result)


def prepare() -> None:
    """Stay on loopback, whatever the shell says."""
    for name in tuple(os.environ):
        if name.startswith(("EPICS_", "ORBITFB_")):
            del os.environ[name]
    os.environ.update(
        EPICS_CA_ADDR_LIST="127.0.0.1",
        EPICS_CA_AUTO_ADDR_LIST="NO",
        OPENBLAS_NUM_THREADS="1",
        OMP_NUM_THREADS="1",
    )


if __name__ == "__main__":
    sys.exit(main())
